"""Values of a trial against the float64 brute force."""

from __future__ import annotations

import numpy as np

from sdm.bench.common.correctness import compare, firm_winding
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.fuzz.trial import Finding


def refuse_wrong(name: str, case: Case, points: np.ndarray, values: np.ndarray, brute: Brute) -> None:
    """Compare signed distances `values` (N,) at `points` (N,3) with those of every triangle.

    Raises:
        Finding: One is off by more than the limit, or has the other sign where the winding number stays on its side.
    """
    distance = brute.distance(points)[0]
    tally = compare(case, points, values, distance, brute.winding_number(points))
    if tally.wrong_signs:
        tally = compare(case, points, values, distance, firm_winding(case, points, brute.winding_number))
    if not tally.fine:
        raise Finding(f"{name}: {tally}")
