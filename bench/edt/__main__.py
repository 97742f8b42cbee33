"""The distance transform of label volumes against SciPy and, on a GPU, CuPy and cuCIM where they are installed.

    python -m sdm.bench.edt [--device cuda] [--quick] [--out bench/results/edt-DEVICE.json]

Every answer is compared with SciPy's before it is timed; then all but SciPy take turns, once they are warm. Peers take
one volume a call, so they go through a batch one by one, and have no signed transform, so they take two. A mask is on
the device to begin with, and so is the answer; on a GPU SciPy's time has the trip to the host and back, since that is
the alternative there.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.common.timing import by_turns, once
from sdm.engine.distance_transform import euclidean_distance_transform

SHAPES = {"4 x 112x112x80": (4, 112, 112, 80), "1 x 256^3": (1, 256, 256, 256)}
QUICK = {"2 x 40x48x33": (2, 40, 48, 33)}
SPACING = (0.625, 0.625, 1.25)
# SciPy measures in float64 from the nearest voxel's indices; this transform rounds a few times in float32.
LIMIT = 6 * 2.0**-24
PEERS = {"CuPy": "cupyx.scipy.ndimage", "cuCIM": "cucim.core.operations.morphology"}
Transform = Callable[[Tensor, bool], Any]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--runs", type=int, default=20, help="most calls to time, of which the median counts")
    parser.add_argument(
        "--budget", type=float, default=5000.0, help="most milliseconds to time one case, after one run"
    )
    parser.add_argument("--quick", action="store_true", help="small volumes, to see that it works")
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    result: dict[str, Any] = {
        "machine": describe(options.device, ("warp-lang", "torch", "numpy", "scipy", "cupy-cuda12x", "cucim-cu12")),
        "spacing": SPACING,
        "cases": [],
    }
    transforms = {"sdm": ours, **gpu_peers(options.device)}
    for name, shape in (QUICK if options.quick else SHAPES).items():
        for kind, mask in masks(shape).items():
            for signed in (False, True):
                row: dict[str, Any] = {"shape": name, "mask": kind, "signed": signed}
                row |= compare(transforms, mask, signed, options)
                result["cases"].append(row)
                print(f"{name:16} {kind:9} {'signed' if signed else 'plain':7}", *cells(row["ms"]), flush=True)
                # Each row as soon as it is there: SciPy takes seconds for one.
                if options.out is not None:
                    write(options.out, result)
                worst = max(row["error"].values())
                if worst > LIMIT:
                    raise SystemExit(f"a transform is off by {worst:.1e} of the distance, more than {LIMIT:.1e}")


def masks(shape: tuple[int, ...]) -> dict[str, Tensor]:
    """An organ of two ellipsoids, one voxel, and noise: near, far and no structure."""
    random = np.random.default_rng(0)
    organ = np.zeros(shape, bool)
    for case in range(shape[0]):
        for centre in (random.uniform(0.35, 0.5, 3), random.uniform(0.5, 0.65, 3)):
            axes = [(np.arange(n) / n - c) / r for n, c, r in zip(shape[1:], centre, (0.2, 0.15, 0.25), strict=True)]
            x, y, z = np.ix_(*axes)
            organ[case] |= x**2 + y**2 + z**2 <= 1
    single = np.zeros(shape, bool)
    single[:, shape[1] // 3, shape[2] // 3, shape[3] // 3] = True
    noise = random.random(shape) < 0.5
    return {name: torch.tensor(mask) for name, mask in (("organ", organ), ("voxel", single), ("noise", noise))}


def compare(
    transforms: dict[str, Transform], mask: Tensor, signed: bool, options: argparse.Namespace
) -> dict[str, Any]:
    there = mask.to(options.device)
    # SciPy takes seconds and compiles nothing: one call.
    milliseconds, truth = once(partial(scipy_transform, there, signed), options.device)
    times = {"SciPy": {"median": milliseconds, "spread": 0.0, "runs": 1}}
    errors = {}
    calls = {name: partial(transform, there, signed) for name, transform in transforms.items()}
    for name, call in calls.items():
        # The first call compiles and takes memory; the second is checked.
        once(call, options.device)
        _, answer = once(call, options.device)
        values = torch.as_tensor(answer, device=options.device).cpu().numpy()
        errors[name] = float((np.abs(values - truth) / np.where(truth == 0, 1.0, np.abs(truth))).max())
    for name, timing in by_turns(calls, options.device, options.runs, options.budget).items():
        times[name] = {"median": timing.ms, "spread": timing.spread, "runs": timing.runs}
    return {"ms": times, "error": errors}


def ours(mask: Tensor, signed: bool) -> Tensor:
    return euclidean_distance_transform(mask, SPACING, signed=signed)


def scipy_transform(mask: Tensor, signed: bool) -> np.ndarray:
    """SciPy's float64 answer, after it has been sent to the device as float32."""
    values = scipy_volumes(mask.cpu().numpy(), signed)
    torch.from_numpy(values.astype(np.float32)).to(mask.device)
    return values


def scipy_volumes(masks: np.ndarray, signed: bool) -> np.ndarray:
    volumes = []
    for mask in masks:
        distance = np.asarray(distance_transform_edt(~mask, SPACING))
        volumes.append(distance - np.asarray(distance_transform_edt(mask, SPACING)) if signed else distance)
    return np.stack(volumes)


def gpu_peers(device: str) -> dict[str, Transform]:
    """Peers that are installed and have the function."""
    found: dict[str, Transform] = {}
    if not device.startswith("cuda"):
        return found
    for name, module in PEERS.items():
        try:
            function = importlib.import_module(module).distance_transform_edt
            cupy = importlib.import_module("cupy")
        except (ImportError, AttributeError) as error:
            print(f"{name} is left out: {error}")
            continue
        found[name] = gpu_peer(function, cupy)
    return found


def gpu_peer(function: Callable[..., Any], cupy: Any) -> Transform:
    def transform(mask: Tensor, signed: bool) -> Any:
        volumes = []
        for volume in mask:
            inside = cupy.asarray(volume)
            distance = function(~inside, sampling=SPACING, float64_distances=False)
            volumes.append(
                distance - function(inside, sampling=SPACING, float64_distances=False) if signed else distance
            )
        return cupy.stack(volumes)

    return transform


def cells(times: dict[str, dict[str, float]]) -> list[str]:
    return [f"{name} {t['median']:9.2f} ms" for name, t in times.items()]


if __name__ == "__main__":
    main()
