"""Coverage: how often the 90 % intervals of a fit hold the truth, over random shapes, poses and noise."""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.fit.tools import backends_by_name, case, counted, fit_case, run_cases, truth_backend

LEVEL_SIGMAS = 1.6448536269514722
# Truths are uniform over the ranges but for their ends, where no interval has two sides.
EDGE = 0.05
NAMES = ("a", "alpha", "b", "phi", "turn x", "turn y", "turn z", "shift x", "shift y", "shift z")


@dataclass(frozen=True)
class _Job:
    scanner: str
    number: int
    options: argparse.Namespace
    path: Path
    deadline: float


def coverage(options: argparse.Namespace) -> None:
    """Fit every case that has no file yet, then sum up what there is."""
    begin, budget = time.monotonic(), options.budget_s
    options.folder.mkdir(parents=True, exist_ok=True)
    jobs = [
        _Job(scanner, number, options, options.folder / f"{options.backend}-{scanner}-{number}.json", begin + budget)
        for number in range(options.count)
        for scanner in ("0.3", "0.2")
    ]
    open_jobs = [job for job in jobs if job.number >= options.first and not job.path.is_file()]
    run_cases(_run, open_jobs, options.processes)
    of = {scanner: counted(job.path for job in jobs if job.scanner == scanner) for scanner in ("0.3", "0.2")}
    summary = {scanner: summarise(records) for scanner, records in of.items()}
    summary = {"backend": options.backend, "wanted": options.count, **summary, "machine": describe(options.device)}
    write(options.out, summary)
    print(json.dumps(summary, indent=1))


def summarise(records: list[dict[str, Any]]) -> dict[str, Any]:
    """Coverage of each unknown's 90 % interval, among the fits that are to be trusted."""
    trusted = [r for r in records if r["trusted"]]
    if not trusted:
        return {"cases": len(records), "trusted": 0}
    z = np.array([r["z"] for r in trusted])
    held = np.abs(z) <= LEVEL_SIGMAS
    shape = held[:, :4].mean()
    return {
        "cases": len(records),
        "trusted": len(trusted),
        "coverage_90": dict(zip(NAMES, held.mean(0).round(4).tolist(), strict=True)),
        "coverage_90_shape": round(float(shape), 4),
        "coverage_90_all": round(float(held.mean()), 4),
        # What the coverage of one unknown varies by, were its true value 0.9.
        "standard_error_of_one": round(math.sqrt(0.09 / len(trusted)), 4),
        "mean_of_z": dict(zip(NAMES, z.mean(0).round(3).tolist(), strict=True)),
        "deviation_of_z": dict(zip(NAMES, z.std(0).round(3).tolist(), strict=True)),
        "largest_z": round(float(np.abs(z).max()), 2),
        "median_deviation": dict(zip(NAMES, np.median([r["deviations"] for r in trusted], 0).tolist(), strict=True)),
        "median_seconds": round(float(np.median([r["seconds"] for r in trusted])), 2),
        "not_trusted": [{"number": r["number"], "problems": r["problems"]} for r in records if not r["trusted"]],
    }


_KEPT: dict[tuple[str, str], Any] = {}


def _run(job: _Job) -> None:
    options = job.options
    if time.monotonic() > job.deadline:
        return
    import torch

    torch.set_num_threads(1)
    key = options.backend, options.device
    if key not in _KEPT:
        _KEPT[key] = truth_backend(options.device), backends_by_name(*key, options.weights)
    truth, backends = _KEPT[key]
    state, image = case(truth, job.scanner, job.number, edge=EDGE)
    result = fit_case(image, job.scanner, backends)
    write(
        job.path,
        {
            "scanner": job.scanner,
            "number": job.number,
            "truth": state.theta.tolist(),
            "estimate": result.state.theta.tolist(),
            "z": result.posterior.standardised(state).tolist(),
            "deviations": result.posterior.deviations.tolist(),
            "trusted": result.trusted,
            "problems": list(result.diagnosis.problems),
            "explained": result.diagnosis.explained,
            "evaluations": result.evaluations,
            "steps": result.steps,
            "seconds": result.seconds,
        },
    )
