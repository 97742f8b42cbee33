"""Errors of the surrogates on the fixed validation set: the table of `sdm.bench.surrogate`."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

from sdm.bench.common.markdown import markdown_table
from sdm.engine.many import signed_distance_maps
from sdm.shapes import Cochlea
from sdm.stream import SDMStream
from sdm.surrogate import GRID, PODChebyshev, load_weights, measure, shipped_weights
from sdm.surrogate.train.map_buffer import Replay
from sdm.surrogate.train.validation import validation_name, validation_theta

COLUMNS = {
    "mae_mm": "MAE",
    "max_mm": "max",
    "mae_near_mm": "MAE near",
    "max_near_mm": "max near",
    "surface_mean_mm": "surface",
    "surface_95_mm": "surface 95 %",
    "dice_mean": "Dice",
    "dice_worst": "worst Dice",
    "slope_error": "slope error",
}
POD_SEED = 77


def accuracy(options: argparse.Namespace) -> dict[str, Any]:
    # In TF32 a map in millimetres would lose its last digit: the figures are those of float32, as on a CPU.
    torch.backends.cudnn.allow_tf32 = False
    theta = validation_theta(Cochlea(), options.count)
    name = validation_name(theta)
    print(f"validation set {name}, {GRID.shape} voxels of {GRID.spacing[0]} mm; near: within 0.5 mm of the surface")
    rows: dict[str, Any] = {}
    for label, facts, surrogate in _surrogates(options):
        if time.perf_counter() > options.deadline:
            print(f"{label}: left out, the budget is spent")
            continue
        start = time.perf_counter()
        summary = measure(surrogate, theta, options.device).summary()
        rows[label] = {**summary, **facts, "seconds": round(time.perf_counter() - start, 1)}
        print(f"{label}: {summary}", flush=True)
    print(markdown_table(["model", *COLUMNS.values()], [_row(label, row) for label, row in rows.items()]))
    return {"validation": name, "count": len(theta), "models": rows}


def _row(label: str, row: dict[str, float]) -> list[str]:
    return [label, *(f"{row[key]:.4f}" for key in COLUMNS)]


def _surrogates(options: argparse.Namespace) -> Iterator[tuple[str, dict[str, Any], Callable[[Tensor], Tensor]]]:
    shipped = shipped_weights()
    files = options.weights or ([shipped] if shipped is not None else [])
    for file in files:
        model, facts = load_weights(file, options.device)
        about = {"file_mb": file.stat().st_size / 1e6, "config": facts["config"], "training": facts.get("training")}
        yield file.stem, about, _quiet(model)
    if options.pod:
        model, about = _pod(options)
        yield f"pod-chebyshev-{options.modes}-{options.degree}", about, _quiet(model)
    family = Cochlea()
    yield "exact maps", {}, lambda theta: _exact(family, theta)


def _quiet(model: torch.nn.Module) -> Callable[[Tensor], Tensor]:
    def run(theta: Tensor) -> Tensor:
        with torch.no_grad():
            return model(theta)

    return run


def _exact(family: Cochlea, theta: Tensor) -> Tensor:
    faces = family.faces_on(theta.device)
    return signed_distance_maps(family.vertices(theta), faces, GRID, device=theta.device)[:, None]


def _pod(options: argparse.Namespace) -> tuple[PODChebyshev, dict[str, Any]]:
    start = time.perf_counter()
    stream = SDMStream(Cochlea(), GRID, 8, POD_SEED, 0, 1, sampler="chebyshev", device=options.device)
    replay = Replay(stream, options.pod)
    replay.fill()
    made = time.perf_counter() - start
    model = PODChebyshev(options.modes, options.degree).to(options.device)
    model.fit(replay.theta, replay.maps)
    about = {
        "maps": options.pod,
        "maps_s": round(made, 1),
        "fit_s": round(time.perf_counter() - start - made, 1),
        "file_mb": 4e-6 * (model.modes.numel() + model.weights.numel() + model.mean.numel()),
    }
    return model, about
