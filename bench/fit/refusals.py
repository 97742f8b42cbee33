"""Refusals of images that have an answer, over noise, voxel size and blur.

Noise runs from none to 400 HU at a contrast of 1600, voxels from 0.15 to 0.6 mm, blur from 0.1 to 0.4 mm; the fit is
told a blur of 0.2 mm and estimates it. An image has an answer where the true shape lies whole in it, whatever the fit
says.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import commit, describe
from sdm.bench.fit.case_rows import commits, rounded
from sdm.bench.fit.coverage import EDGE, LEVEL_SIGMAS
from sdm.bench.fit.tools import counted, exact_backends, run_cases
from sdm.core.grid import Grid
from sdm.core.random import derive_seed
from sdm.fit import ExactBackend, FitOptions, Scanner, State, fit_shape, random_state, simulate
from sdm.fit.model.jacobian import vertices_of
from sdm.fit.solve.formation.estimate import estimate_formation

NOISES = (0.0, 1.0, 5.0, 20.0, 50.0, 100.0, 200.0, 400.0)
SPACING, BLUR, NAMED_BLUR = (0.15, 0.6), (0.1, 0.4), 0.2


def scanner_of(number: int) -> Scanner:
    """The scanner of a case: a pure function of its number."""
    rng = np.random.default_rng(derive_seed(number, "scanner of a refusal"))
    spacing, blur = float(np.exp(rng.uniform(*np.log(SPACING)))), float(rng.uniform(*BLUR))
    return Scanner(spacing=spacing, blur=blur, noise=NOISES[number % len(NOISES)])


def refusals(options: argparse.Namespace) -> None:
    """Fit every case that has no file yet, then sum up what there is."""
    options.folder.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + options.budget_s
    numbers = range(options.first, options.count)
    jobs = [(number, options, deadline) for number in numbers if not path_of(number, options.folder).is_file()]
    run_cases(run, jobs, options.processes)
    sum_up(options)


def sum_up(options: argparse.Namespace) -> None:
    """Write the record, and print it without its cases."""
    first = options.first * (not path_of(0, options.folder).is_file())
    found = summary(counted(path_of(number, options.folder) for number in range(first, options.count)))
    report = {"wanted": options.count, **found, "machine": describe(options.device)}
    cases = report.pop("cases")
    write(options.out, {**report, "cases": rounded(cases)})
    print(json.dumps(report, indent=1))


def summary(records: list[dict[str, Any]]) -> dict[str, Any]:
    """Refusals among the images with an answer, by noise, for the fit alone and with its formation estimated."""
    whole = [r for r in records if r["whole"]]
    refused = sum(not r["trusted"] for r in whole)
    rows = []
    for noise in NOISES:
        own = [r for r in whole if r["noise"] == noise]
        if own:
            held = [np.abs(r["z"][:4]) <= LEVEL_SIGMAS for r in own if r["trusted"]]
            rows.append({
                "noise_HU": noise,
                "images": len(own),
                "refused": sum(not r["trusted"] for r in own),
                "refused_plain": sum(not r["trusted_plain"] for r in own),
                "coverage_90_shape": round(float(np.mean(held)), 3) if held else None,
            })  # fmt: skip
    return {
        "images": len(records),
        "with_an_answer": len(whole),
        "refused": refused,
        "refused_at_most_95": at_most(refused, len(whole)),
        "refused_plain": sum(not r["trusted_plain"] for r in whole),
        "median_cpu_seconds": round(float(np.median([r["cpu_seconds"] for r in records])), 2) if records else None,
        "by_noise": rows,
        "commits": commits(records),
        "cases": records,
    }


def at_most(count: int, of: int, level: float = 0.95) -> float:
    """The share that `count` of `of` bounds from above with a confidence of `level` (Clopper and Pearson 1934)."""
    from scipy.stats import beta

    return round(float(beta.ppf(level, count + 1, of - count)), 4) if count < of else 1.0


def lies_whole(truth: ExactBackend, state: State, grid: Grid) -> bool:
    """True if every vertex of a state's shape lies between the middles of the image's outermost voxels."""
    world = state.to_world(vertices_of(truth.family, state.theta))
    axes = torch.from_numpy(grid.affine[:3, :3]).to(world)
    index = torch.linalg.solve(axes, (world - torch.from_numpy(grid.affine[:3, 3]).to(world)).T).T
    most = torch.tensor(grid.shape).to(world) - 1
    return bool(((index >= 0) & (index <= most)).all())


def path_of(number: int, folder: Path) -> Path:
    """The file of a case."""
    return folder / f"{number}.json"


def run(job: tuple[int, argparse.Namespace, float]) -> None:
    """Fit one image, if there is time, and write its file."""
    number, options, deadline = job
    if time.monotonic() > deadline:
        return
    truth, backend = exact_backends(options.device)
    begin = time.process_time()
    state, scanner = random_state(truth, number, edge=EDGE), scanner_of(number)
    image = simulate(truth, state, scanner, seed=number, margin=2.0)
    own = FitOptions(blur=NAMED_BLUR)
    plain = fit_shape(image.values, image.grid, backend, options=own)
    found = estimate_formation(image.values, image.grid, backend, plain, own)
    write(path_of(number, options.folder), {
        "number": number,
        "noise": scanner.noise,
        "spacing": scanner.spacing,
        "blur": scanner.blur,
        "trusted": found.trusted,
        "problems": list(found.diagnosis.problems),
        "trusted_plain": plain.trusted,
        "problems_plain": list(plain.diagnosis.problems),
        "z": found.posterior.standardised(state).tolist(),
        "off": (found.state.theta - state.theta).tolist(),
        "found_blur": None if found.blur is None else found.blur[0],
        "whole": lies_whole(truth, state, image.grid),
        "cpu_seconds": time.process_time() - begin,
        "commit": commit(),
    })  # fmt: skip
