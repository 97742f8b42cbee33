"""Random nasty meshes: maps and points against the float64 brute force, and against each other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

import sdm
from sdm.bench.common.correctness import voxel_centres
from sdm.bench.common.mesh_formulas import Arrays, cube, joined, sphere, torus
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.fuzz.against_brute import refuse_wrong
from sdm.bench.fuzz.trial import Outcome, one_sentence

# Half of the points lie near the surface, as near as this share of the mesh.
NEAR = 1e-3


def soup(rng: np.random.Generator) -> Arrays:
    """Loose triangles of all sizes, some without area."""
    count = int(rng.integers(1, 60))
    size = 10.0 ** rng.uniform(-5, 0, (count, 1, 1))
    corners = rng.uniform(-1, 1, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    flat = rng.random(count) < 0.3
    weight = rng.uniform(size=(count, 1))
    corners[flat, 2] = (corners[:, 0] + weight * (corners[:, 1] - corners[:, 0]))[flat]
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def holes(rng: np.random.Generator) -> Arrays:
    """A closed mesh that lacks some faces, has some twice and some turned."""
    vertices, faces = (sphere(8), torus(200), cube())[rng.integers(3)]
    faces = faces[rng.random(len(faces)) > rng.choice([0.01, 0.1, 0.4])]
    faces = np.concatenate([faces, faces[rng.random(len(faces)) < 0.1]])
    turned = rng.random(len(faces)) < rng.choice([0.0, 0.1, 0.5])
    faces[turned] = faces[turned, ::-1]
    return vertices, rng.permutation(faces).astype(np.int32) if len(faces) else cube()[1]


def few_vertices(rng: np.random.Generator) -> Arrays:
    """Random triangles over few vertices: repeated corners and faces, edges in all directions."""
    count = int(rng.integers(3, 12))
    return rng.normal(size=(count, 3)).astype(np.float32), rng.integers(0, count, (40, 3)).astype(np.int32)


def split_edges(rng: np.random.Generator) -> Arrays:
    """A closed prism whose edges carry vertices of one side only, filled with thin triangles: T-junctions."""
    vertices, faces = cube()
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    parts = []
    for _ in range(int(rng.integers(1, 6))):
        a, b = vertices[rng.choice(len(vertices), 2, replace=False)]
        weights = np.sort(rng.uniform(size=2))
        parts.append(np.stack([a, a + weights[0] * (b - a), a + weights[1] * (b - a)]))
    thin = np.concatenate(parts).astype(np.float32)
    both = joined((vertices, faces), (thin, np.arange(len(thin), dtype=np.int32).reshape(-1, 3)))
    return (both[0] @ turn.T * rng.uniform(0.1, 10)).astype(np.float32), both[1]


def far_away(rng: np.random.Generator) -> Arrays:
    """A mesh far from the origin, or very small, or very large."""
    vertices, faces = holes(rng)
    scale = 10.0 ** rng.uniform(-12, 12)
    return (scale * (vertices + rng.normal(size=3) * 10.0 ** rng.uniform(-2, 3))).astype(np.float32), faces


SHAPES: dict[str, Callable[[np.random.Generator], Arrays]] = {
    "soup": soup,
    "holes": holes,
    "few vertices": few_vertices,
    "split edges": split_edges,
    "far away": far_away,
}


def _points(case: Case, rng: np.random.Generator) -> np.ndarray:
    low, high = case.box
    size = max(float((high - low).max()), 1e-30)
    anywhere = low + (high - low) * rng.uniform(-0.3, 1.3, (100, 3))
    corners = case.vertices[case.faces[rng.integers(len(case.faces), size=200)]].astype(np.float64)
    weights = rng.dirichlet([0.5] * 3, 200)[:, :, None]
    near = (corners * weights).sum(1) + size * NEAR * rng.normal(size=(200, 3)) * 10.0 ** rng.uniform(-6, 0, (200, 1))
    return np.concatenate([anywhere, near]).astype(np.float32)


def trial(rng: np.random.Generator, folder: Path, device: str = "cpu") -> Outcome:
    """One mesh: 300 points and a small map."""
    label = list(SHAPES)[rng.integers(len(SHAPES))]
    vertices, faces = SHAPES[label](rng)
    case = Case(label, vertices, faces, frozenset())
    with one_sentence(label):
        mesh = sdm.TriangleMesh(vertices, faces)
        brute = Brute(vertices, faces, device)
        points = _points(case, rng)
        low, high = case.box
        step = np.maximum((high - low) / 7, 1e-6 * np.abs(case.vertices).max() + 1e-30)
        grid = sdm.Grid(low - step, step, rng.integers(4, 12, 3))
        values = sdm.signed_distance_map(mesh, grid, device=device).values.cpu().numpy().reshape(-1)
        at = {"points": (points, sdm.signed_distance(mesh, points, device=device).cpu().numpy())}
        at["map"] = voxel_centres(grid, np.arange(grid.size)), values
        for what, (places, found) in at.items():
            refuse_wrong(f"{label}, {what}", case, places, found, brute)
    return Outcome(label, refused=False)
