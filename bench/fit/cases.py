"""Nine simulated cases: errors against the truth, and what other distances make of the same images.

As Table 2 of Wang et al., MIDL 2020, which has nine cases and the difference of the parameters that its surrogate and
its meshes find. Here the truth is known too.
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
from sdm.bench.fit.tools import STOCK, backends_by_name, case, fit_case, truth_backend
from sdm.errors import SDMError
from sdm.fit import FitResult, Image, State
from sdm.shapes import Cochlea

EDGE = 0.1
WIDTHS = np.array([p.high - p.low for p in Cochlea.parameters])


def cases(options: argparse.Namespace) -> None:
    """Fit each case with each backend, print a line each, write all; with `--resume` those that no run has ended."""
    names = options.backends.split(",")
    if "exact" not in names:
        names.insert(0, "exact")
    machine = describe(options.device, ("warp-lang", "torch", "numpy", "libigl"))
    before = _before(options.out)
    done = _done(options.out, names, machine) if options.resume else set()
    truth = truth_backend()
    backends = {name: backends_by_name(name, options.device, options.weights) for name in names}
    deadline = time.monotonic() + options.budget_s
    rows: list[dict[str, Any]] = []
    warm = False
    for number in range(options.first, 2 if options.quick else options.count, options.step):
        if number + 1 in done:
            rows.append(before[number + 1])
            continue
        if time.monotonic() > deadline:
            continue
        # Two thirds as a clinical scanner sees them, the others as a cone-beam scanner does.
        scanner = "0.2" if number % 3 == 2 else "0.3"
        state, image = case(truth, scanner, 1000 + number, edge=EDGE)
        if not warm:
            # Kernels are compiled and libraries loaded before the clock runs.
            for name in names:
                _warm_up(backends[name], image, scanner)
            warm = True
        # None is always the first after another's.
        found, cpu_s = {}, {}
        for name in names[:: 1 - 2 * (number % 2)]:
            begin = time.process_time()
            found[name] = fit_case(image, scanner, backends[name])
            cpu_s[name] = round(time.process_time() - begin, 2)
        row = {"case": number + 1, "voxel_mm": float(scanner), "image": list(image.grid.shape)}
        row |= {name: _row(found[name], found["exact"], state) | {"cpu_seconds": cpu_s[name]} for name in names}
        row["truth"] = dict(zip(("a", "alpha", "b", "phi"), state.theta.tolist(), strict=True))
        old = before.get(number + 1, {})
        rows.append({**(old if old.get("truth") == row["truth"] else {}), **row})
        for name in names:
            print(f"{number + 1} {scanner} mm {name:<10}", row[name], flush=True)
        write(options.out, {"cases": rows, "summary": _summary(rows), "machine": machine})
    if rows:
        write(options.out, {"cases": rows, "summary": _summary(rows), "machine": machine})
        print(_summary(rows))


def _before(out: Path) -> dict[int, dict[str, Any]]:
    """Rows of an earlier run in the file, by case: those of backends that are not run again stay."""
    return {row["case"]: row for row in json.loads(out.read_text())["cases"]} if out.is_file() else {}


def _done(out: Path, names: list[str], machine: dict[str, Any]) -> set[int]:
    """Cases that the file has of all these backends, by a machine like this one: clocks of others are not these."""
    if not out.is_file():
        return set()
    record = json.loads(out.read_text())
    if any(record["machine"].get(key) != machine.get(key) for key in ("device", "cores")):
        raise SDMError(f"{out} is of another machine ({record['machine'].get('device')}); give another file by --out")
    return {row["case"] for row in record["cases"] if all(name in row for name in names)}


def _warm_up(backends: Any, image: Image, scanner: str) -> None:
    backend, finish = backends
    for each in (backend, finish):
        if each is None:
            continue
        middle = image.values.new_tensor([(p.low + p.high) / 2 for p in each.parameters]).double()
        points = image.grid.points()[::8, ::8, ::8].reshape(-1, 3).double()
        each.with_derivatives(middle.to(each.device), points.to(each.device))


def _row(result: FitResult, exact: FitResult, truth: State) -> dict[str, Any]:
    theta, reference = result.state.theta.cpu().numpy(), exact.state.theta.cpu().numpy()
    names = [p.name for p in result.parameters]
    shift = float((result.state.translation.cpu() - truth.translation.cpu()).norm())
    return {
        "trusted": result.trusted,
        "warnings": list(result.diagnosis.warnings),
        "error": dict(zip(names, (theta - truth.theta.cpu().numpy()).round(6).tolist(), strict=True)),
        "deviation": dict(zip(names, result.posterior.deviations[:4].tolist(), strict=True)),
        "shift_error_mm": round(shift, 5),
        "relative_to_exact": float(np.abs((theta - reference) / reference).max()),
        "in_deviations_of_exact": float(
            np.abs((theta - reference) / exact.posterior.deviations[:4].cpu().numpy()).max()
        ),
        "shapes_built": result.evaluations,
        "steps": result.steps,
        "seconds": round(result.seconds, 2),
    }


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    summary: dict[str, Any] = {}
    # Of all rows alike.
    names = [name for name in rows[0] if all(isinstance(row.get(name), dict) and name != "truth" for row in rows)]
    exact = np.array([list(row["exact"]["error"].values()) for row in rows])
    for name in names:
        found = [row[name] for row in rows]
        errors = np.array([list(f["error"].values()) for f in found])
        deviations = np.array([list(f["deviation"].values()) for f in found])
        summary[name] = {
            "mean_absolute_error": dict(zip(found[0]["error"], np.abs(errors).mean(0).round(6).tolist(), strict=True)),
            "largest_relative_to_exact": max(f["relative_to_exact"] for f in found),
            # phi has no natural zero: beside that, the difference as a share of the parameter's range.
            "largest_share_of_range_from_exact": float((np.abs(errors - exact) / WIDTHS).max().round(7)),
            # Of the intervals of 90 %, all parameters of all cases together.
            "share_within_90": float((np.abs(errors) < 1.6448536 * deviations).mean().round(4)),
            "median_shapes_built": float(np.median([sum(f["shapes_built"].values()) for f in found])),
            "median_seconds": float(np.median([f["seconds"] for f in found])),
            "median_cpu_seconds": float(np.median([f["cpu_seconds"] for f in found if "cpu_seconds" in f] or [0.0])),
        }
    for stock in (name for name in names if name in STOCK):
        for name in (name for name in names if name not in STOCK):
            ratios = [row[stock]["seconds"] / row[name]["seconds"] for row in rows]
            low, middle, high = np.percentile(ratios, [25, 50, 75]).round(2).tolist()
            summary[name][f"times_faster_than_{stock}"] = middle
            summary[name][f"quartiles_of_times_faster_than_{stock}"] = [low, high]
            if all("cpu_seconds" in row[stock] and "cpu_seconds" in row[name] for row in rows):
                # Of all threads together: what other work on the cores changes least.
                ratios = [row[stock]["cpu_seconds"] / row[name]["cpu_seconds"] for row in rows]
                summary[name][f"times_less_cpu_than_{stock}"] = round(float(np.median(ratios)), 2)
    return summary
