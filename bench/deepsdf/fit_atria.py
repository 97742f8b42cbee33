"""A left atrium that a DeepSDF never saw, by its codes: from an image, and from points.

    python -m sdm.bench.deepsdf.fit_atria train --data ../shared/data --out runs/atria --budget-s 90
    python -m sdm.bench.deepsdf.fit_atria fit --data ../shared/data --model runs/atria

`train` takes the other 72 atria without duplicates and without near twins of the validation set's 8 (the same atrium at
another time). `fit` fits each of the 8 (`fit_deepsdf`): size, pose and a dozen components first, then all numbers of
the code; the image, its label map blurred and made noisy, and the points, 2,000, half a voxel off in each direction,
are those of `sdm.bench.shapes.atrium_fit`. Distances are means over both ways from the smooth surface of the label.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm.bench.common.checkout import data_folder, results_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.deepsdf.shapes import SPACING_MM, atria, left_out_labels
from sdm.bench.deepsdf.study.atria_split import duplicates_of, read_record, twins_of
from sdm.bench.shapes.atrium_fit import SCANNED, SCATTER, distance, image_of, scan_of
from sdm.core.device import choose_device
from sdm.deepsdf import DeepSDF, local, train
from sdm.deepsdf.infer.fit_backend import DeepSDFBackend, factor_of_model
from sdm.deepsdf.infer.fit_code import surface_of_code
from sdm.deepsdf.infer.fit_deepsdf import fit_deepsdf, fit_deepsdf_points
from sdm.deepsdf.samples import ShapeSet
from sdm.deepsdf.samples.label_surface import label_surface
from sdm.fit.solve.fit_family import usual_options
from sdm.viz.fit_figure import surface_at


def main(words: list[str] | None = None) -> None:
    """Train on the other atria, or fit each that is left out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("train", "fit"))
    parser.add_argument("--data", type=Path, default=data_folder(), help="the data folder, or its packed file")
    parser.add_argument("--model", type=Path, help="of fit: what train wrote")
    parser.add_argument("--out", type=Path, default=results_folder() / "fit-atria-deepsdf.json")
    parser.add_argument("--first", type=int, default=0, help="the first atrium to fit")
    parser.add_argument("--count", type=int, default=8, help="atria to leave out, of the validation set's 8")
    parser.add_argument("--training", type=int, default=None, help="of the others, so many (default: all)")
    parser.add_argument("--noise", type=float, default=0.2, help="standard deviation, as a share of the contrast")
    parser.add_argument("--blur", type=float, default=1.0, help="standard deviation [voxels]")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--budget-s", type=float, default=None, help="of training; of fit: begin none after this long")
    options = parser.parse_args(words)
    {"train": run_train, "fit": run_fit}[options.command](options)


def run_train(options: argparse.Namespace) -> None:
    """Write a model into a folder."""
    record = read_record()
    found = atria(options.data)
    names = [mesh.name for mesh in found.test]
    away = set(names) | twins_of(record, names) | set(duplicates_of(record))
    meshes = [mesh for mesh in found.training if mesh.name not in away][: options.training]
    shapes = ShapeSet(meshes, choose_device(options.device))
    train(
        shapes, local(), options.out, names=shapes.names, spheres=shapes.spheres, budget_s=options.budget_s,
        device=shapes.device, compile_network=False,
        progress=lambda step, _, loss: print(step, f"{loss:.5f}", flush=True) if step % 500 == 0 else None,
    )  # fmt: skip


def run_fit(options: argparse.Namespace) -> None:
    """Write a row for each atrium, and means."""
    begin, device = time.perf_counter(), choose_device(options.device)
    model = DeepSDF.load(options.model, device)
    rows = json.loads(options.out.read_text())["atria"] if options.first and options.out.is_file() else []
    for number, (name, mask) in enumerate(left_out_labels(options.data, options.count).items()):
        late = options.budget_s is not None and time.perf_counter() - begin > options.budget_s
        if number < options.first or late:
            continue
        if name in model.names:
            raise SystemExit(f"{name} is among the shapes that {options.model} was trained on")
        rows.append({"name": name, "of": len(model.names), **_row(model, mask, number, options, device)})
        print(rows[-1], flush=True)
        keys = [key for key in rows[0] if key.endswith(("_mm", "_s"))]
        write(options.out, {
            "machine": describe(str(device)), "voxel_mm": SPACING_MM, "blur_voxels": options.blur,
            "noise_of_contrast": options.noise, "points": SCANNED, "scatter_voxels": SCATTER,
            "numbers": model.code_size, "training": _training_of(options.model),
            "mean": {key: round(float(np.mean([row[key] for row in rows])), 4) for key in keys}, "atria": rows,
        })  # fmt: skip


def _training_of(model: Path) -> dict[str, Any]:
    from sdm.deepsdf.train.checkpoint import read_model

    found = read_model(model)
    return {"shapes": len(found["names"]), "steps": found["step"], "seconds": round(found["seconds"], 1)}


def _row(model: DeepSDF, mask: torch.Tensor, number: int, options: argparse.Namespace, device: Any) -> dict[str, Any]:
    mesh = label_surface(mask, SPACING_MM)
    image, grid = image_of(mask, options.blur, options.noise, number)
    backend = DeepSDFBackend(model)
    own = usual_options(grid, factor_of_model(model), blur=options.blur * SPACING_MM)
    start = time.perf_counter()
    fit = fit_deepsdf(image, grid, model, options=own)
    middle = time.perf_counter()
    scan = scan_of(mesh, number, device)
    before = time.perf_counter()
    points = fit_deepsdf_points(scan, model)
    end = time.perf_counter()
    assert fit.code is not None
    surface = surface_of_code(backend, points.code.code, points.code.state)
    return {
        "components_mm": distance(surface_at(backend, fit.result.state), mesh, device),
        "code_mm": distance(fit.code.mesh(backend), mesh, device),
        "size": [round(float(state.theta[0]), 3) for state in (fit.result.state, fit.code.state)],
        "explained": round(fit.result.diagnosis.explained, 4),
        "trusted": fit.result.trusted,
        "problems": list(fit.result.diagnosis.problems),
        "steps": fit.result.steps,
        "noise": round(fit.code.noise, 2),
        "fit_s": round(middle - start, 2),
        "points_components_mm": distance(surface_at(backend, points.components.posterior.state), mesh, device),
        "points_mm": distance(surface, mesh, device),
        "points_noise_mm": round(points.code.noise, 4),
        "points_size": round(float(points.code.state.theta[0]), 3),
        "points_determined": round(points.code.determined, 1),
        "points_s": round(end - before, 2),
    }


if __name__ == "__main__":
    main()
