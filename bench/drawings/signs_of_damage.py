"""Signs of one shape with three kinds of damage: winding number, its sign, and a flood's, on a slice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common.mesh_formulas import torus
from sdm.bench.drawings.panels import INK, INSIDE, OUTSIDE, panels

SIDE, HOLE = 121, 0.45


def _ring() -> sdm.TriangleMesh:
    vertices, faces = torus(9_000)
    return sdm.TriangleMesh(torch.as_tensor(vertices, dtype=torch.float32), torch.as_tensor(faces, dtype=torch.int32))


def damaged() -> dict[str, sdm.TriangleMesh]:
    """A ring as it is, with a hole, with half its faces turned, and as a soup whose faces face all ways."""
    ring = _ring()
    middles = ring.vertices[ring.faces.long()].mean(1)
    hole = (middles[:, 0] > 0.65) & (middles[:, 1].abs() < 0.18)  # of the outer side alone
    turned = ring.faces.clone()
    half = middles[:, 0] < 0
    turned[half] = turned[half].flip(1)
    mixed = ring.faces.clone()
    some = torch.rand(len(mixed), generator=torch.Generator().manual_seed(0)) < 0.5
    mixed[some] = mixed[some].flip(1)
    return {
        "closed": ring,
        "a hole": sdm.TriangleMesh(ring.vertices, ring.faces[~hole]),
        "half of it inside out": sdm.TriangleMesh(ring.vertices, turned),
        "faces face all ways": sdm.TriangleMesh(ring.vertices, mixed),
    }


def cut(mesh: sdm.TriangleMesh, height: float) -> np.ndarray:
    """Segments (S,2,2) where a plane across z cuts a mesh."""
    import trimesh

    vertices, faces = mesh.numpy()
    found: Any = trimesh.intersections.mesh_plane(
        trimesh.Trimesh(vertices, faces, process=False), np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, height])
    )
    return np.asarray(found)[:, :, :2]


def draw_signs(path: Path) -> None:
    """Four meshes in rows: what their winding number is, and what two signs make of it."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    meshes = damaged()
    low, high = (np.asarray(corner) for corner in next(iter(meshes.values())).bounds)
    step = float((high - low).max() * 1.3 / (SIDE - 1))
    middle = (low + high) / 2
    layers = int((high - low)[2] * 1.6 / step) | 1
    shape = (SIDE, SIDE, layers)
    grid = sdm.Grid(tuple(middle - step * (np.array(shape) - 1) / 2), (step,) * 3, shape)
    reach = step * SIDE / 2
    look: dict[str, Any] = {
        "origin": "lower",
        "extent": [middle[0] - reach, middle[0] + reach, middle[1] - reach, middle[1] + reach],
    }
    places = grid.points()[:, :, layers // 2].reshape(-1, 3)
    sides = ListedColormap([OUTSIDE, INSIDE])
    with panels(path, len(meshes), 3, (9.0, 12.6), "What is inside? One ring, four conditions", dpi=85) as axes:
        for row, (name, mesh) in zip(axes, meshes.items(), strict=True):
            index = sdm.MeshIndex(mesh, device="cpu", warn=False)
            winding = index.winding_number(places).reshape(SIDE, SIDE).numpy()
            drawn = row[0].imshow(winding.T, cmap="PuOr_r", vmin=-1, vmax=1, **look)
            by_winding = index.signed_distance_map(grid).values[:, :, layers // 2]
            by_flood = index.signed_distance_map(grid, sign="flood", hole_size=HOLE).values[:, :, layers // 2]
            for ax, values in ((row[1], by_winding), (row[2], by_flood)):
                ax.imshow((values < 0).numpy().T, cmap=sides, vmin=0, vmax=1, **look)
            for ax in row:
                ax.add_collection(LineCollection(list(cut(mesh, middle[2] + 1e-4)), colors=INK, linewidths=1.0))
            row[0].set_ylabel(name, fontsize=12, color=INK)
        for ax, title in zip(axes[0], ("winding number", 'sign="winding"', 'sign="flood"'), strict=True):
            ax.set_title(title)
        figure: Any = axes[0, 0].figure
        figure.colorbar(drawn, ax=axes[-1, 0], location="bottom", shrink=0.9, aspect=24, pad=0.03)
        for ax in axes[-1, 1:]:
            patches = [Patch(color=INSIDE, label="inside"), Patch(color=OUTSIDE, label="outside")]
            ax.legend(handles=patches, loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=2, labelcolor="0.3")
