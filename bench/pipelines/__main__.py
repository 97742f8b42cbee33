"""Samples a second of MONAI's, TorchIO's and batchgeneratorsv2's pipelines with distance maps, by sdm and by SciPy.

    python -m sdm.bench.pipelines [--device cuda] [--quick] [--out bench/results/pipelines-DEVICE.json]

A sample is a scan with labels of several classes, which is turned and scaled at random (nearest neighbours for labels),
and then gets a signed distance map in mm of each class. The pipelines differ in the last step alone: sdm's transform of
that library, SciPy's `distance_transform_edt` inside and outside of each class, or nothing. Both maps of a sample are
compared before anything is timed. One process and no workers; a library that is not installed is left out. On a GPU
labels are put there first, where MONAI turns them; TorchIO and batchgeneratorsv2 turn theirs on the CPU.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.edt.multiclass import organs
from sdm.bench.pipelines.libraries import LIBRARIES, Pipeline
from sdm.errors import SDMError

# Classes and shape.
CASES = {"cpu": ((8, (96, 96, 96)),), "cuda": ((8, (96, 96, 96)), (16, (128, 128, 128)))}
QUICK = ((3, (20, 24, 16)),)
SPACING = (0.8, 0.8, 1.5)
# Of the distance: SciPy measures in float64.
LIMIT = 1e-6
VERSIONS = ("monai", "torchio", "batchgeneratorsv2", "scipy", "torch", "warp-lang", "numpy")
KINDS = ("nothing", "sdm", "SciPy")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--quick", action="store_true", help="a small volume, to see that it works")
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    result: dict[str, Any] = {"machine": describe(options.device, VERSIONS), "spacing": SPACING, "cases": []}
    for classes, shape in QUICK if options.quick else CASES[options.device.split(":")[0]]:
        labels = torch.from_numpy(organs(classes, shape))[None]
        for name, make in LIBRARIES.items():
            try:
                pipelines = {kind: make(kind, classes, SPACING, options.device) for kind in KINDS}
            except (ImportError, SDMError) as error:
                print(f"{name} is left out: {error}")
                continue
            row: dict[str, Any] = {"library": name, "classes": classes, "shape": shape}
            row["error"] = difference(pipelines, labels)
            row |= {kind: rates(pipeline, labels, options) for kind, pipeline in pipelines.items()}
            result["cases"].append(row)
            print(row, flush=True)
            if row["error"] > LIMIT:
                raise SystemExit("a map is off")
            if options.out is not None:
                write(options.out, result)


def difference(pipelines: dict[str, Pipeline], labels: torch.Tensor) -> float:
    """Largest difference of the maps by sdm and SciPy of one turned sample, as a share of the distance."""
    found = {kind: seeded(pipelines[kind], labels, 0) for kind in ("sdm", "SciPy")}
    ours, theirs = (torch.as_tensor(np.asarray(maps.cpu())).double() for maps in found.values())
    return float(((ours - theirs).abs() / theirs.abs().clamp(min=1e-3)).max())


def seeded(pipeline: Pipeline, labels: torch.Tensor, seed: int) -> Any:
    """The pipeline's result; its random turn depends on the seed alone."""
    np.random.seed(seed)  # noqa: NPY002 (batchgeneratorsv2 draws from it)
    torch.manual_seed(seed)
    return pipeline(labels.clone(), seed)


def rates(pipeline: Callable[..., Any], labels: torch.Tensor, options: argparse.Namespace) -> dict[str, float]:
    """Samples a second by the clock, and CPU seconds of all threads a sample."""
    seeded(pipeline, labels, 0)
    wall, cpu = time.perf_counter(), time.process_time()
    for seed in range(options.samples):
        seeded(pipeline, labels, seed)
    if options.device.startswith("cuda"):
        torch.cuda.synchronize()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {"samples_per_s": options.samples / wall, "cpu_s_per_sample": cpu / options.samples}


if __name__ == "__main__":
    main()
