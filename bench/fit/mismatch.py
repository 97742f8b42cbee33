"""Coverage under mismatch: the share of 90 % intervals that hold the truth in images unlike those that the fit assumes.

Each case is one shape under one noise, imaged in several ways, so that conditions are compared case by case. A
condition is a change of the image, or of what the fit takes for granted.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.fit.coverage import EDGE, LEVEL_SIGMAS, summarise
from sdm.bench.fit.tools import counted, exact_backends, run_cases
from sdm.core.random import derive_seed
from sdm.fit import SCANNERS, FitOptions, Image, fit_shape, random_state, simulate

Noise = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]
CLINICAL = SCANNERS["0.3"]
CORRELATION_VOXELS = 0.6
SHADING = 0.1
TAILS = 3.0  # degrees of freedom


def white(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Independent normal noise of unit deviation: what the fit assumes."""
    return rng.standard_normal(shape)


def correlated(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """White noise smoothed over 0.6 voxels, of unit deviation again."""
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(rng.standard_normal(shape), CORRELATION_VOXELS, mode="wrap")
    return noise / noise.std()


def heavy_tailed(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Student's t with three degrees of freedom, scaled to unit deviation."""
    return rng.standard_t(TAILS, shape) / np.sqrt(TAILS / (TAILS - 2))


@dataclass(frozen=True, kw_only=True)
class Condition:
    """A way in which image and fit differ.

    Args:
        note: In words.
        noise: Of unit deviation.
        shading: Intensities change by this share towards both ends of x.
        options: Of the fit, where they are not those of the image.
    """

    note: str
    noise: Noise = white
    shading: float = 0.0
    options: dict[str, Any] = field(default_factory=dict)


CONDITIONS = {
    "matched": Condition(note="all as the fit assumes"),
    "blur-0.20": Condition(note="a blur of 0.25 mm taken for 0.2", options={"blur": 0.2}),
    "blur-0.30": Condition(note="a blur of 0.25 mm taken for 0.3", options={"blur": 0.3}),
    "correlated": Condition(note="noise correlated over 0.6 voxels", noise=correlated),
    "heavy-tailed": Condition(note="noise of Student's t with 3 degrees of freedom", noise=heavy_tailed),
    "shading": Condition(note="shading of 10 % along x", shading=SHADING),
    "labels": Condition(note="each voxel taken for one or the other", options={"model": "labels"}),
    "several": Condition(
        note="blur taken for 0.2, correlated noise and shading",
        noise=correlated,
        shading=SHADING,
        options={"blur": 0.2},
    ),
}


def image_of(clean: Image, condition: Condition, number: int) -> Image:
    """The condition's image from one without noise: a pure function of the case's number."""
    rng = np.random.default_rng(derive_seed(number, "mismatch noise"))
    values = clean.values.numpy().astype(np.float64)
    across = np.linspace(-1.0, 1.0, values.shape[0])[:, None, None]
    values = values * (1 + condition.shading * across) + CLINICAL.noise * condition.noise(rng, values.shape)
    return Image(torch.from_numpy(values.astype(np.float32)), clean.grid)


def mismatch(options: argparse.Namespace) -> None:
    """Fit every case under every condition that has no file yet, then sum up what there is."""
    options.folder.mkdir(parents=True, exist_ok=True)
    deadline = time.monotonic() + options.budget_s
    jobs = [(number, options, deadline) for number in range(options.first, options.count) if _open(number, options)]
    run_cases(_run, jobs, options.processes)
    report = {name: {"note": condition.note, **_summary(name, options)} for name, condition in CONDITIONS.items()}
    record = {"scanner": vars(CLINICAL), "wanted": options.count, "conditions": report}
    write(options.out, {**record, "machine": describe(options.device)})
    for name, found in report.items():
        print(f"{name:13} {found.get('coverage_90_shape')} of {found['trusted']} trusted, {found['cases']} cases")


def _path(name: str, number: int, options: argparse.Namespace) -> Path:
    return options.folder / f"{name}-{number}.json"


def _open(number: int, options: argparse.Namespace) -> list[str]:
    return [name for name in CONDITIONS if not _path(name, number, options).is_file()]


def _run(job: tuple[int, argparse.Namespace, float]) -> None:
    """The fits of one case that are still to be made, while there is time."""
    number, options, deadline = job
    truth, backend = exact_backends(options.device)
    state = random_state(truth, number, edge=EDGE)
    clean = simulate(truth, state, replace(CLINICAL, noise=0.0), seed=number)
    for name in _open(number, options):
        if time.monotonic() > deadline:
            return
        image = image_of(clean, CONDITIONS[name], number)
        fit_options = FitOptions(**{"blur": CLINICAL.blur, **CONDITIONS[name].options})
        result = fit_shape(image.values, image.grid, backend, options=fit_options)
        row = {
            "number": number,
            "z": result.posterior.standardised(state).tolist(),
            "deviations": result.posterior.deviations.tolist(),
            "trusted": result.trusted,
            "problems": list(result.diagnosis.problems),
            "seconds": result.seconds,
        }
        write(_path(name, number, options), row)


def _summary(name: str, options: argparse.Namespace) -> dict[str, Any]:
    records = counted(_path(name, number, options) for number in range(options.count))
    summary = summarise(records)
    trusted = [r for r in records if r["trusted"]]
    if trusted:
        # Of one shape's four parameters together: what the coverage of all four varies by from sample to sample.
        held = (np.abs([r["z"][:4] for r in trusted]) <= LEVEL_SIGMAS).mean(1)
        summary["standard_error_shape"] = round(float(held.std(ddof=1) / np.sqrt(len(held))), 4) if len(held) > 1 else 0
    return summary
