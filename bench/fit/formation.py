"""Coverage with the image's formation estimated: other blur, correlated noise, shading, thick slices, turned shapes.

The fit is told a blur of 0.2 mm and no more. Each case is one shape under one noise in all conditions.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import commit, describe
from sdm.bench.fit.case_rows import commits, merged, write_rows
from sdm.bench.fit.coverage import EDGE, LEVEL_SIGMAS, summarise
from sdm.bench.fit.mismatch import CLINICAL, Condition, correlated, image_of
from sdm.bench.fit.tools import counted, exact_backends, run_cases
from sdm.core.grid import Grid
from sdm.core.random import derive_seed
from sdm.fit import FitOptions, Image, State, fit_shape, random_state, simulate
from sdm.fit.model.pose import rotation_from_vector
from sdm.fit.solve.formation.estimate import estimate_formation

NAMED_BLUR = 0.2
PLAIN = Condition(note="")


@dataclass(frozen=True)
class Case:
    """A condition of the image.

    Args:
        note: In words.
        look: Noise and shading.
        blur: The scanner's [mm].
        thick: Voxels along z are this many times as long.
        turned: The shape is turned by up to 90 degrees.
    """

    note: str
    look: Condition = PLAIN
    blur: float = NAMED_BLUR
    thick: float = 1.0
    turned: bool = False


CASES = {
    "matched": Case("a blur of 0.2 mm, as named"),
    "blur": Case("a blur of 0.3 mm, named 0.2", blur=0.3),
    "correlated": Case("noise correlated over 0.6 voxels", Condition(note="", noise=correlated)),
    "shading": Case("shading of 10 % along x", Condition(note="", shading=0.1)),
    "thick": Case("slices of 0.6 mm", thick=2.0),
    "turned": Case("turned by up to 90 degrees about any axis", turned=True),
}


def scene(truth: Any, case: Case, number: int) -> tuple[State, Image]:
    """The true state and its image: a pure function of case and number."""
    state = random_state(truth, number, edge=EDGE)
    margin = 1.5
    if case.turned:
        rng = np.random.default_rng(derive_seed(number, "turned by up to 90 degrees"))
        axis = rng.standard_normal(3)
        vector = axis / np.linalg.norm(axis) * rng.uniform(0, math.pi / 2)
        state = replace(state, rotation=rotation_from_vector(torch.from_numpy(vector)).to(state.rotation))
    scanner = replace(CLINICAL, noise=0.0, blur=case.blur)
    grid = None
    if case.turned or case.thick != 1:
        half = np.full(3, 1.35 * float(state.theta[0]) + margin)
        if not case.turned:
            half[2] = 2.4 + margin
        spacing = np.array([1, 1, case.thick]) * scanner.spacing
        count = np.ceil(2 * half / spacing).astype(int)
        rng = np.random.default_rng(derive_seed(number, "grid of a scene"))
        origin = state.translation.cpu().numpy() - spacing * (count - 1) / 2 + rng.uniform(-0.5, 0.5, 3) * spacing
        grid = Grid(origin.tolist(), spacing.tolist(), count.tolist())
    clean = simulate(truth, state, scanner, seed=number, grid=grid)
    return state, image_of(clean, case.look, number)


def formation(options: argparse.Namespace) -> None:
    """Fit every case under every condition that has no file yet, then sum up what there is."""
    options.folder.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + options.budget_s
    jobs = [
        (name, number, options, deadline)
        for number in range(options.first, options.count)
        for name in CASES
        if not path_of(name, number, options.folder).is_file()
    ]
    run_cases(run, jobs, options.processes)
    sum_up(options)


def sum_up(options: argparse.Namespace) -> None:
    """Write the record and its rows, a line a case.

    Where the record has cases of which no rows are left (`before`), the rows are of those that follow.
    """
    before = before_rows(options.out)
    first = before["cases"] if before else options.first * (not path_of("matched", 0, options.folder).is_file())
    rows = {name: _counted(name, first, options) for name in CASES}
    report = {}
    for name, case in CASES.items():
        found = _summary(rows[name])
        report[name] = {"note": case.note, **(merged(before["conditions"][name], found) if before else found)}
    write(options.out, {
        "wanted": options.count, "named_blur_mm": NAMED_BLUR, "conditions": report,
        "rows": {"file": rows_of(options.out).name, "from": first, "commits": commits(itertools.chain(*rows.values()))},
        **({"before": before} if before else {}), "machine": describe(options.device),
    })  # fmt: skip
    write_rows(rows_of(options.out), [{"condition": name, **row} for name in CASES for row in rows[name]])
    for name, found in report.items():
        print(f"{name:11} {found.get('coverage_90_shape')} of {found['trusted']} trusted, {found['cases']} cases; "
              f"before {found.get('coverage_90_shape_before')}")  # fmt: skip


def rows_of(out: Path) -> Path:
    """The file of a record's rows."""
    return out.with_suffix(".jsonl")


def before_rows(out: Path) -> dict[str, Any] | None:
    """The summary of the first cases, of which no rows are left; None where there are none such."""
    return json.loads(out.read_text()).get("before") if out.is_file() else None


def _counted(name: str, first: int, options: argparse.Namespace) -> list[dict[str, Any]]:
    return counted(path_of(name, number, options.folder) for number in range(first, options.count))


def path_of(name: str, number: int, folder: Path) -> Path:
    """The file of a case."""
    return folder / f"{name}-{number}.json"


def run(job: tuple[str, int, argparse.Namespace, float]) -> None:
    """Fit one case, if there is time, and write its file."""
    name, number, options, deadline = job
    if time.monotonic() > deadline:
        return
    truth, backend = exact_backends(options.device)
    state, image = scene(truth, CASES[name], number)
    own = FitOptions(blur=NAMED_BLUR, turn=1.0 if CASES[name].turned else 0.5)
    first = fit_shape(image.values, image.grid, backend, options=own)
    begin = time.perf_counter()
    found = estimate_formation(image.values, image.grid, backend, first, own)
    it = found.formation
    write(path_of(name, number, options.folder), {
        "number": number,
        "z": found.posterior.standardised(state).tolist(),
        "z_before": first.posterior.standardised(state).tolist(),
        "deviations": found.posterior.deviations.tolist(),
        "trusted": found.trusted,
        "trusted_before": first.trusted,
        "problems": list(found.diagnosis.problems),
        "blur": None if it is None else it.blur,
        "effective_share": None if it is None else it.effective_share,
        "p_value": None if it is None else it.p_value,
        "seconds": first.seconds,
        "seconds_formation": time.perf_counter() - begin,
        "commit": commit(),
    })  # fmt: skip


def _summary(records: list[dict[str, Any]]) -> dict[str, Any]:
    summary = summarise(records)
    before = [r["z_before"][:4] for r in records if r["trusted_before"]]
    if before:
        summary["coverage_90_shape_before"] = round(float((np.abs(before) <= LEVEL_SIGMAS).mean()), 4)
        summary["trusted_before"] = len(before)
    trusted = [r for r in records if r["trusted"]]
    if len(trusted) > 1:
        held = (np.abs([r["z"][:4] for r in trusted]) <= LEVEL_SIGMAS).mean(1)
        summary["standard_error_shape"] = round(float(held.std(ddof=1) / np.sqrt(len(held))), 4)
    return summary
