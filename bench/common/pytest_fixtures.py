"""Fixtures of the pytest-benchmark files: peers on meshes, checked before they are timed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from sdm.bench.common import query_points as sampling
from sdm.bench.common.correctness import LIMIT, compare
from sdm.bench.common.meshes import Case, load_case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.peers import Peer, all_peers

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
MESHES = ["torus-20000", "sphere"]
CHECKED = 1_000
# A peer that misses this share of the box or of the signs answers another question: no time of it counts.
WRONG_DISTANCE, WRONG_SIGNS = 1e-2, 1e-2


def parameters(*, points: bool) -> list[Any]:
    """Every peer on every device and mesh; only those that take scattered points if `points`."""
    return [
        pytest.param(peer, mesh, id=f"{peer.name}-{peer.device}-{mesh}".replace(" ", "_"))
        for device in DEVICES
        for peer in all_peers(device)
        for mesh in MESHES
        if peer.points_too or not points
    ]


def built(peer: Peer, mesh: str) -> Case:
    """The mesh, built into the peer; skips where the peer is missing."""
    note = peer.missing()
    if note is not None:
        pytest.skip(note)
    case = load_case(mesh)
    peer.build(case)
    return case


def scattered(case: Case, count: int) -> np.ndarray:
    """Points (count,3) float32: half anywhere, half near the surface, mixed."""
    points = np.concatenate([sampling.uniform(case, count - count // 2), sampling.near(case, count // 2)])
    return sampling.generator(case, "mixed").permutation(points)


def check_then_time(benchmark: Any, peer: Peer, case: Case, at: np.ndarray, call: Callable[[], Tensor]) -> None:
    """Compare a call's answers at points (N,3) with the brute force, then time it; the first call compiles."""
    which = sampling.generator(case, "checked").integers(0, len(at), CHECKED)
    brute = Brute(case.vertices, case.faces)
    values = call().reshape(-1).cpu().numpy()[which]
    tally = compare(case, at[which], values, brute.distance(at[which])[0], brute.winding_number(at[which]))
    low, high = case.box
    unit = 2.0**-24 * max(np.abs(low).max(), np.abs(high).max())
    most = LIMIT if peer.name == "sdm" else WRONG_DISTANCE * float((high - low).max()) / unit
    assert tally.max_error <= most
    assert tally.wrong_signs <= (0 if peer.name == "sdm" else WRONG_SIGNS * CHECKED)

    def waited() -> None:
        call()
        if peer.device.startswith("cuda"):
            torch.cuda.synchronize()

    benchmark.pedantic(waited, rounds=5, warmup_rounds=1)
    benchmark.extra_info |= {"max_error_roundings": tally.max_error, "wrong_signs": tally.wrong_signs}
    benchmark.extra_info |= {"million_per_second": len(at) / benchmark.stats.stats.median / 1e6}
