"""Largest errors of distances, mesh by mesh, from the accuracy record of a CPU."""

from __future__ import annotations

import json
from pathlib import Path

from sdm.bench.common.checkout import results_folder
from sdm.bench.common.figure import OURS, colour_of, drawing

KINDS = {
    "uniform": "anywhere in the box",
    "near": "within two voxels of the surface",
    "surface": "on the surface",
    "in line": "in line with edges",
    "far": "ten box sizes away",
    "voxels": "voxels of a map",
    "turned": "voxels on turned axes",
}


def draw_errors(path: Path) -> None:
    """A dot for each mesh, a line for each kind of point, and the limit."""
    record = json.loads((results_folder() / "accuracy-cpu.json").read_text())
    meshes = list(record["meshes"].values())
    wrong = sum(kind["wrong_signs"] for mesh in meshes for kind in mesh["kinds"].values())
    points = sum(mesh["points"] for mesh in meshes)
    caption = (
        f"{len(meshes)} real and nasty meshes, {points:,} points, against a float64 brute force over all triangles; "
        f"a rounding is 2^-24 of the largest coordinate of mesh and point. {wrong} wrong signs. "
        "python -m sdm.bench.dense.accuracy, accuracy-cpu.json"
    )
    with drawing(path, caption, (10.5, 5.6)) as (_, axes):
        for place, kind in enumerate(KINDS):
            errors = sorted(mesh["kinds"][kind]["max_error"] for mesh in meshes if kind in mesh["kinds"])
            spread = [place + 0.3 * (2 * (i % 9) / 8 - 1) for i in range(len(errors))]
            axes.plot(errors, spread, "o", color=colour_of(OURS, []), markersize=4.5, alpha=0.55, markeredgewidth=0)
        limit = record["limit"]
        axes.axvline(limit, color="0.25", linewidth=1.6)
        axes.text(limit - 0.04, -0.75, f"the limit: {limit:g} roundings", ha="right", va="center", color="0.25")
        axes.set_yticks(range(len(KINDS)), list(KINDS.values()))
        axes.set_ylim(len(KINDS) - 0.4, -1.1)
        axes.set_xlim(0, limit * 1.05)
        axes.set_xlabel("largest error of a mesh [float32 roundings]")
        axes.set_title("How exact: the largest error of each mesh")
        axes.grid(visible=True, axis="x")
        axes.set_position((0.3, 0.225, 0.675, 0.665))
        axes.set_title(axes.get_title(loc="left"), loc="left", x=-0.425)
