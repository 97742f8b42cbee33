"""Refusals of images that have an answer, over noise, voxel size and blur.

Noise runs from none to 400 HU at a contrast of 1600, voxels from 0.15 to 0.6 mm, blur from 0.1 to 0.4 mm; the fit is
told a blur of 0.2 mm and estimates it. An image has an answer where the shape lies whole in it.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.fit.coverage import EDGE, LEVEL_SIGMAS
from sdm.bench.fit.tools import exact_backends, run_cases
from sdm.core.random import derive_seed
from sdm.fit import FitOptions, Scanner, fit_shape, random_state, simulate
from sdm.fit.solve.formation.estimate import estimate_formation

NOISES = (0.0, 1.0, 5.0, 20.0, 50.0, 100.0, 200.0, 400.0)
SPACING, BLUR, NAMED_BLUR = (0.15, 0.6), (0.1, 0.4), 0.2
BORDER = "reaches the image's border"


def scanner_of(number: int) -> Scanner:
    """The scanner of a case: a pure function of its number."""
    rng = np.random.default_rng(derive_seed(number, "scanner of a refusal"))
    spacing, blur = float(np.exp(rng.uniform(*np.log(SPACING)))), float(rng.uniform(*BLUR))
    return Scanner(spacing=spacing, blur=blur, noise=NOISES[number % len(NOISES)])


def refusals(options: argparse.Namespace) -> None:
    """Fit every case that has no file yet, then sum up what there is."""
    options.folder.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + options.budget_s
    jobs = [(number, options, deadline) for number in range(options.count) if not _path(number, options).is_file()]
    run_cases(_run, jobs, options.workers)
    paths = [_path(number, options) for number in range(options.count)]
    found = summary([json.loads(path.read_text()) for path in paths if path.is_file()])
    write(options.out, {"wanted": options.count, **found, "machine": describe(options.device)})
    print(json.dumps({key: value for key, value in found.items() if key != "cases"}, indent=1))


def summary(records: list[dict[str, Any]]) -> dict[str, Any]:
    """Refusals among the images with an answer, by noise, for the fit alone and with its formation estimated."""
    whole = [r for r in records if not any(BORDER in p for p in r["problems_plain"])]
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
        "refused": sum(not r["trusted"] for r in whole),
        "refused_plain": sum(not r["trusted_plain"] for r in whole),
        "by_noise": rows,
        "cases": records,
    }


def _path(number: int, options: argparse.Namespace) -> Path:
    return options.folder / f"{number}.json"


def _run(job: tuple[int, argparse.Namespace, float]) -> None:
    number, options, deadline = job
    if time.monotonic() > deadline:
        return
    truth, backend = exact_backends(options.device)
    state, scanner = random_state(truth, number, edge=EDGE), scanner_of(number)
    image = simulate(truth, state, scanner, seed=number, margin=2.0)
    own = FitOptions(blur=NAMED_BLUR)
    plain = fit_shape(image.values, image.grid, backend, options=own)
    found = estimate_formation(image.values, image.grid, backend, plain, own)
    write(_path(number, options), {
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
    })  # fmt: skip
