"""Signed distance maps of every class of a volume, beside SciPy, edt, and on a GPU CuPy and cuCIM, class by class.

    python -m sdm.bench.edt.multiclass [--device cuda] [--quick] [--out bench/results/edt-multiclass-DEVICE.json]

Labels are ellipsoids over each other, as organs of a scan. Answers are compared before they are timed, by turns. On a
CPU times are CPU seconds of the process, so that a machine that does other things besides says little less; edt has one
thread there. On a GPU they are milliseconds by events.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.common.timing import by_turns
from sdm.bench.edt.__main__ import LIMIT, PEERS

# Classes and shape.
CASES = {"cpu": ((16, (128, 128, 128)), (64, (96, 96, 96))), "cuda": ((16, (512, 512, 512)), (64, (128, 128, 128)))}
QUICK = ((4, (24, 30, 20)),)
SPACING = (0.8, 0.8, 1.5)
LIBRARIES = ("warp-lang", "torch", "numpy", "scipy", "edt", "cupy-cuda12x", "cucim-cu12")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="a small volume, to see that it works")
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    kind = options.device.split(":")[0]
    result: dict[str, Any] = {"machine": describe(options.device, LIBRARIES), "spacing": SPACING, "cases": []}
    for classes, shape in QUICK if options.quick else CASES[kind]:
        labels = organs(classes, shape)
        calls = calls_for(labels, classes, options.device)
        row: dict[str, Any] = {"classes": classes, "shape": shape, "error": errors(calls)}
        row["cpu_ms" if kind == "cpu" else "ms"] = timed(calls, options)
        result["cases"].append(row)
        print(classes, shape, row, flush=True)
        if options.out is not None:
            write(options.out, result)
        if max(row["error"].values()) > LIMIT:
            raise SystemExit("a transform is off")


def organs(classes: int, shape: tuple[int, ...]) -> np.ndarray:
    """Labels (x,y,z) uint8: an ellipsoid of each class, somewhere, later ones over earlier ones."""
    random = np.random.default_rng(0)
    labels = np.zeros(shape, np.uint8)
    for value in range(1, classes + 1):
        centre, radius = random.uniform(0.15, 0.85, 3), random.uniform(0.5, 1.5, 3) * 0.35 / classes ** (1 / 3)
        # The box around it, with a voxel of room.
        box = tuple(
            slice(max(int(n * (c - r)) - 1, 0), int(n * (c + r)) + 2)
            for n, c, r in zip(shape, centre, radius, strict=True)
        )
        places = (np.arange(n)[part] for n, part in zip(shape, box, strict=True))
        x, y, z = np.ix_(*((i / n - c) / r for i, n, c, r in zip(places, shape, centre, radius, strict=True)))
        labels[box][x**2 + y**2 + z**2 <= 1] = value
    return labels


def calls_for(labels: np.ndarray, classes: int, device: str) -> dict[str, Callable[[], Any]]:
    """Calls of each library that is installed, ours first; of NumPy on a CPU, else of what is on the device."""
    values = range(1, classes + 1)
    if device == "cpu":
        calls: dict[str, Callable[[], Any]] = {
            "sdm": lambda: sdm.euclidean_distance_transform(labels, SPACING, classes=classes, signed=True),
            "SciPy": partial(class_by_class, labels, values, _scipy, np),
        }
        try:
            edt = importlib.import_module("edt")
        except ImportError as error:
            print(f"edt is left out: {error}")
            return calls
        return calls | {"edt": partial(class_by_class, labels, values, partial(_edt, edt), np)}
    there = torch.from_numpy(labels).to(device)
    calls = {"sdm": lambda: sdm.euclidean_distance_transform(there, SPACING, classes=classes, signed=True)}
    for name, module in PEERS.items():
        try:
            function = importlib.import_module(module).distance_transform_edt
            cupy = importlib.import_module("cupy")
        except (ImportError, AttributeError) as error:
            print(f"{name} is left out: {error}")
            continue
        one = partial(_cupy, function)
        calls[name] = partial(class_by_class, cupy.asarray(there), values, one, cupy)
    return calls


def class_by_class(labels: Any, values: range, transform: Callable[[Any], Any], arrays: Any) -> Any:
    out = arrays.empty((len(values), *labels.shape), arrays.float32)
    for number, value in enumerate(values):
        inside = labels == value
        out[number] = transform(~inside)
        out[number] -= transform(inside)
    return out


def _scipy(mask: np.ndarray) -> Any:
    from scipy.ndimage import distance_transform_edt

    return distance_transform_edt(mask, SPACING)


def _edt(edt: Any, mask: np.ndarray) -> Any:
    return edt.edt(mask, SPACING, black_border=False, parallel=1)


def _cupy(function: Callable[..., Any], mask: Any) -> Any:
    return function(mask, sampling=SPACING, float64_distances=False)


def errors(calls: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Largest difference of each answer from SciPy's, or the last library's, as a share of the distance."""
    answers = {name: torch.as_tensor(call()) for name, call in calls.items()}
    truth = answers.get("SciPy", list(answers.values())[-1])
    return {name: _error(found, truth) for name, found in answers.items() if found is not truth}


def _error(found: torch.Tensor, truth: torch.Tensor) -> float:
    # Class by class, as all of them together leave little room.
    return max(
        float(((one - true).abs() / torch.where(true == 0, 1.0, true.abs())).max())
        for one, true in zip(found, truth, strict=True)
    )


def timed(calls: dict[str, Callable[[], Any]], options: argparse.Namespace) -> dict[str, float]:
    """Milliseconds of each, the least of `runs` calls by turns; on a CPU of all threads together."""
    if options.device != "cpu":
        return {name: timing.ms for name, timing in by_turns(calls, options.device, options.runs, 60_000).items()}
    least = dict.fromkeys(calls, float("inf"))
    for _ in range(options.runs):
        for name, call in calls.items():
            begin = time.process_time()
            call()
            least[name] = min(least[name], 1e3 * (time.process_time() - begin))
    return least


if __name__ == "__main__":
    main()
