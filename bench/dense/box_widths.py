"""Errors of distances by the width of the boxes that are measured as a whole: what `region_grid.COARSEST` follows from.

    python -m sdm.bench.dense.box_widths [--trials 20] [--out box-widths.json]

Meshes are turned, scaled and shifted at random, with grids around places on them whose cells of 8^3 voxels are as wide
as asked, in units of the mesh's largest coordinate. All cells are measured whole, and compared with one search for each
voxel. Errors are in roundings: 2^-24 of the largest coordinate of mesh and voxel. On a CPU.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import Case, load_case
from sdm.engine.plan_override import plan_override
from sdm.kernels.dense import region_grid

MESHES = ("torus-1000", "cube", "random soup", "needle box", "thin soups", "needle fan", "loose slivers")
WIDTHS = (0.125, 0.2, 0.25, 0.35)
VOXELS, CELL = 24, 8
ROUNDING = 2.0**-24


def placed(case: Case, rng: np.random.Generator) -> np.ndarray:
    """The mesh's vertices (V,3), turned, scaled and shifted."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    vertices = (case.vertices - case.vertices.mean(0)) @ turn.T
    size = rng.uniform(0.5, 1.0)
    vertices *= 0.9 * size / np.abs(vertices[case.faces]).max()
    return np.asarray(vertices + rng.uniform(-0.1, 0.1, 3) * size, np.float32)


def roundings(vertices: np.ndarray, faces: np.ndarray, width: float, rng: np.random.Generator) -> float:
    """The largest error of a map whose cells have this half-width."""
    largest = float(np.abs(vertices[faces]).max())
    step = 2 * width * largest / (CELL - 1)
    middle = vertices[faces[rng.integers(len(faces))]].mean(0) + rng.uniform(-0.2, 0.2, 3) * largest
    grid = sdm.Grid(middle - step * (VOXELS - 1) / 2, (step,) * 3, (VOXELS,) * 3)
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu", warn=False)
    with plan_override(method="cells", cell=CELL, slice_factors=(1,)):
        found = index.signed_distance_map(grid).values.abs().double()
    with plan_override(method="search"):
        searched = index.signed_distance_map(grid).values.abs().double()
    scale = grid.points().abs().amax(-1).double().clamp(min=largest)
    return float(((found - searched).abs() / (ROUNDING * scale)).max())


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20, help="placements of each mesh")
    parser.add_argument("--out", type=Path, help="a JSON file")
    given = parser.parse_args()
    # Before kernels are built.
    region_grid.COARSEST = 1e9
    rows: list[dict[str, Any]] = []
    for name in MESHES:
        case = load_case(name)
        for width in WIDTHS:
            rng = np.random.default_rng(0)
            worst = max(roundings(placed(case, rng), case.faces, width, rng) for _ in range(given.trials))
            rows.append({"mesh": name, "width": width, "roundings": worst})
        print(name, *(f"{row['roundings']:.2f} ({row['width']})" for row in rows[-len(WIDTHS) :]), flush=True)
    for width in WIDTHS:
        print(f"{width}: {max(row['roundings'] for row in rows if row['width'] == width):.2f} roundings")
    if given.out:
        json_file.write(given.out, {"machine": describe("cpu"), "trials": given.trials, "rows": rows})


if __name__ == "__main__":
    main()
