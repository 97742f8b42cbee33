"""Near-degenerate triangles: points and maps, signed and unsigned, against exact rational arithmetic.

Loose slivers of all heights, and closed solids whose edges are split on one side and filled with thin triangles, as CAD
files have them. Places lie on the lines of edges, where an inside test in floating point is noise.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

import sdm
from sdm.bench.common.correctness import compare, voxel_centres
from sdm.bench.common.degenerate_meshes import filled_t_junctions, thin_soup
from sdm.bench.common.mesh_formulas import Arrays, cube, sphere, torus
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles import rational
from sdm.bench.dense.parts.signs import unsigned as without_signs
from sdm.bench.fuzz.edge_lines import grid_in_line, points_in_line
from sdm.bench.fuzz.trial import Finding, Outcome, one_sentence
from sdm.engine.plan_override import plan_override
from sdm.kernels.plan_options import MAP_METHODS, POINT_METHODS

# A fraction takes about 0.1 ms for a point and a triangle, so that a trial is about a tenth of a second.
COMPARISONS = 1500
MOST_PLACES = 60
VOXELS = 9


def soup(rng: np.random.Generator) -> Arrays:
    """One to five loose slivers, often on one line."""
    corner = thin_soup(rng, int(rng.integers(1, 6)))
    return corner.reshape(-1, 3), np.arange(corner.size // 3, dtype=np.int32).reshape(-1, 3)


def t_junctions(rng: np.random.Generator) -> Arrays:
    """A turned prism, one edge of which is split on one side."""
    return filled_t_junctions(int(rng.integers(1, 8)), int(rng.integers(1 << 30)))


def split_solid(rng: np.random.Generator) -> Arrays:
    """A turned closed solid; edges are split in one of their faces, and thin triangles fill the gap."""
    vertices, faces = (cube(), sphere(3), torus(24))[rng.integers(3)]
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    vertices = vertices @ (turn * np.sign(np.linalg.det(turn)))
    for _ in range(int(rng.integers(1, 5))):
        which = int(rng.integers(len(faces)))
        a, b, c = np.roll(faces[which], int(rng.integers(3)))
        middle = vertices[a] + rng.uniform() * (vertices[b] - vertices[a])
        new = len(vertices)
        vertices = np.concatenate([vertices, middle[None]])
        thin = [[a, new, c], [new, b, c], [a, b, new]]
        faces = np.concatenate([np.delete(faces, which, axis=0), np.array(thin, np.int32)])
    return vertices, faces.astype(np.int32)


def flattened(rng: np.random.Generator) -> Arrays:
    """A turned closed solid, squeezed to almost nothing along one axis."""
    vertices, faces = (cube(), sphere(3), torus(24))[rng.integers(3)]
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    squeezed = vertices * np.array([1, 1, 10.0 ** rng.uniform(-8, -2)])
    return squeezed @ (turn * np.sign(np.linalg.det(turn))), faces


SHAPES: dict[str, tuple[Callable[[np.random.Generator], Arrays], bool]] = {
    "soup": (soup, False),
    "t-junctions": (t_junctions, True),
    "split solid": (split_solid, True),
    "flattened": (flattened, True),
}


def _winding(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Winding numbers (N,) float64 of a closed mesh; one half, which compares no sign, on the surface."""
    corner = vertices[faces]
    found = np.full(len(points), 0.5)
    for number, point in enumerate(points):
        try:
            found[number] = rational.winding_number(corner, point)
        except ValueError:
            continue
    return found


def trial(rng: np.random.Generator, folder: Path, device: str = "cpu") -> Outcome:
    """One mesh: points and voxels by one of the paths, with signs and without."""
    label = list(SHAPES)[rng.integers(len(SHAPES))]
    make, closed = SHAPES[label]
    vertices, faces = make(rng)
    scale = 10.0 ** rng.uniform(-3, 3) if rng.random() < 0.3 else 1.0
    vertices = (scale * (vertices + (rng.random() < 0.2) * 10 * rng.normal(size=3))).astype(np.float32)
    case, mesh = Case(label, vertices, faces, frozenset()), sdm.TriangleMesh(vertices, faces)
    corner = vertices[faces]
    count = int(np.clip(COMPARISONS // len(faces), 10, MOST_PLACES))
    points, grid = points_in_line(corner, rng, count), grid_in_line(corner, rng, VOXELS)
    voxels = rng.choice(grid.size, count, replace=False)
    centres = voxel_centres(grid, voxels)
    paths = {
        "method": MAP_METHODS[rng.integers(len(MAP_METHODS))],
        "points_method": POINT_METHODS[rng.integers(len(POINT_METHODS))],
    }
    with one_sentence(label) as refused, plan_override(**paths):
        at_points = sdm.signed_distance(mesh, points, device=device).cpu().numpy()
        field = sdm.signed_distance_map(mesh, grid, device=device).values.cpu().numpy().reshape(-1)[voxels]
        with without_signs():
            unsigned = sdm.signed_distance_map(mesh, grid, device=device).values.cpu().numpy().reshape(-1)[voxels]
    if refused:
        raise Finding(f"{label}: refused")
    if not np.array_equal(np.abs(field), unsigned):
        raise Finding(f"{label} by {paths}: an unsigned map has other bits than the signed one")
    for what, where, found in (("points", points, at_points), ("map", centres, field)):
        winding = _winding(vertices, faces, where) if closed else None
        tally = compare(case, where, found, rational.distance(vertices, faces, where), winding)
        if not tally.fine:
            raise Finding(f"{label}, {what} by {paths}: {tally}")
    return Outcome(label, refused=False)
