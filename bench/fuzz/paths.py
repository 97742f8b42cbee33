"""One answer by every path: first, repeated, recorded, joint and moved calls about random dirty meshes.

Their bits are compared with each other, and some of their values with the float64 brute force. On a GPU where there is
one, else on the CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

import sdm
from sdm.bench.common.correctness import voxel_centres
from sdm.bench.common.dirty_meshes import by_code as dirt
from sdm.bench.common.mesh_formulas import Arrays, cube, joined, moved, sphere, torus
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.fuzz.against_brute import refuse_wrong
from sdm.bench.fuzz.trial import Finding, Outcome, one_sentence

# Voxels, and points, that the brute force is asked about.
CHECKED = 400
# Calls about copies of a mesh, of which later ones are recorded and recordings are replayed.
COPIES = 4
# Voxels along an axis.
LEAST, MOST = 9, 72


def clean(rng: np.random.Generator) -> Arrays:
    """A closed mesh of some hundred to some thousand triangles, stretched."""
    size = float(rng.uniform(0, 1)) ** 2
    vertices, faces = (torus(int(100 + 6000 * size)), sphere(int(6 + 40 * size)), cube())[rng.integers(3)]
    return (vertices * rng.uniform(0.3, 1.5, 3)).astype(np.float32), faces


def torn(rng: np.random.Generator) -> Arrays:
    """A mesh that lacks a share of its faces."""
    return dirt.torn(clean(rng), float(rng.choice([0.002, 0.02, 0.1, 0.3, 0.6])), int(rng.integers(99)))


def turned(rng: np.random.Generator) -> Arrays:
    """A mesh some faces of which are turned."""
    return dirt.turned(clean(rng), float(rng.choice([0.01, 0.1, 0.5, 1.0])), int(rng.integers(99)))


def repeated(rng: np.random.Generator) -> Arrays:
    """A mesh some faces of which are there several times."""
    vertices, faces = clean(rng)
    again = faces[rng.random(len(faces)) < rng.choice([0.05, 1.0])]
    return vertices, rng.permutation(np.concatenate([faces, *[again] * int(rng.integers(1, 4))])).astype(np.int32)


def loose(rng: np.random.Generator) -> Arrays:
    """Faces that share no vertex, with gaps between them or without."""
    return dirt.loose(clean(rng), float(rng.choice([0.0, 0.002, 0.02])), int(rng.integers(99)))


def made(rng: np.random.Generator) -> Arrays:
    """Sheets, open boxes or half spheres, few or many."""
    seed, count = int(rng.integers(99)), int(rng.choice([1, 5, 40, 150]))
    return (
        lambda: dirt.sheets(count, seed),
        lambda: dirt.boxes(count, seed),
        lambda: dirt.half_spheres(count, int(rng.integers(3, 9)), seed),
    )[rng.integers(3)]()


def parts(rng: np.random.Generator) -> Arrays:
    """A dirty mesh and another one, which cross or lie apart."""
    first, second = (KINDS[list(KINDS)[rng.integers(5)]](rng) for _ in range(2))
    return joined(first, moved(second, float(rng.uniform(0.05, 1)), tuple(rng.uniform(-1.2, 1.2, 3))))


KINDS: dict[str, Callable[[np.random.Generator], Arrays]] = {
    "clean": clean,
    "torn": torn,
    "turned": turned,
    "repeated": repeated,
    "loose": loose,
    "made": made,
    "parts": parts,
}


def _grid(case: Case, rng: np.random.Generator) -> sdm.Grid:
    """A grid around a mesh, or around some of it, whose axes have what counts they have."""
    low, high = case.box
    size = np.maximum(high - low, 1e-3)
    begin, end = low - size * rng.uniform(-0.3, 0.4, 3), high + size * rng.uniform(-0.3, 0.4, 3)
    counts = rng.integers(LEAST, MOST, 3) if rng.random() < 0.6 else np.full(3, rng.integers(LEAST, MOST))
    spacing = np.maximum(end - begin, 0.1 * size) / counts
    return sdm.Grid(begin, np.full(3, spacing.max()) if rng.random() < 0.6 else spacing, counts)


def _maps(case: Case, grid: sdm.Grid, other: tuple[Case, sdm.Grid], device: str) -> Iterator[tuple[str, Any]]:
    """The same map by each path, the repeated one first."""
    copy = _copies(case)
    index = sdm.MeshIndex(copy(), device, warn=False)
    for number in range(3):
        yield f"an index's call {number}", index.signed_distance_map(grid)
    for number in range(COPIES):
        yield f"copy {number}", sdm.signed_distance_map(copy(), grid, device=device)
    another, its_grid = other
    meshes = [copy(), _copies(another)(), copy()]
    both = sdm.signed_distance_maps(meshes, [grid, its_grid, grid], device=device)
    yield "the first of a list", both[0]
    yield "the last of a list", both[2]
    elsewhere = sdm.MeshIndex(sdm.TriangleMesh(case.vertices[::-1].copy(), case.faces), device, warn=False)
    elsewhere.update(torch.tensor(case.vertices, device=device))
    yield "an index that was moved", elsewhere.signed_distance_map(grid)


def _points(case: Case, points: np.ndarray, other: Case, device: str) -> Iterator[tuple[str, Any]]:
    copy = _copies(case)
    index = sdm.MeshIndex(copy(), device, warn=False)
    for number in range(2):
        yield f"an index's points {number}", index.signed_distance(points)
    meshes = [_copies(other)(), copy(), copy()]
    found = list(sdm.signed_distances(meshes, [points[:7], points, points], device=device))
    yield "points of a list", found[1]
    yield "the list's last points", found[2]


def _copies(case: Case) -> Callable[[], sdm.TriangleMesh]:
    return lambda: sdm.TriangleMesh(case.vertices.copy(), case.faces.copy())


def trial(rng: np.random.Generator, folder: Path) -> Outcome:
    """One mesh and grid by each path."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    label = list(KINDS)[rng.integers(len(KINDS))]
    cases = []
    for kind in (label, list(KINDS)[rng.integers(len(KINDS))]):
        vertices, faces = KINDS[kind](rng)
        cases.append(Case(kind, vertices, faces if len(faces) else cube()[1], frozenset()))
    case, other = cases
    grid, its_grid = (_grid(one, rng) for one in cases)
    low, high = case.box
    points = rng.uniform(low - 0.3, high + 0.3, (int(rng.choice([60, 900, 3000])), 3)).astype(np.float32)
    with one_sentence(label):
        _, expected = next(iter(_maps(case, grid, (other, its_grid), device)))
        for name, found in _maps(case, grid, (other, its_grid), device):
            _refuse_difference(f"{label}, {name}", found.values, expected.values)
            if found.ambiguous_voxels != expected.ambiguous_voxels:
                raise Finding(f"{label}, {name}: {found.ambiguous_voxels} ambiguous, not {expected.ambiguous_voxels}")
        _, distances = next(iter(_points(case, points, other, device)))
        for name, found in _points(case, points, other, device):
            _refuse_difference(f"{label}, {name}", found, distances)
        brute = Brute(case.vertices, case.faces, device)
        some = rng.integers(grid.size, size=CHECKED)
        checked = {
            "voxels": (voxel_centres(grid, some), expected.values.reshape(-1).cpu().numpy()[some]),
            "points": (points[:CHECKED], distances.cpu().numpy()[:CHECKED]),
        }
        for what, (places, values) in checked.items():
            refuse_wrong(f"{label}, {what}", case, places, values, brute)
    return Outcome(label, refused=False)


def _refuse_difference(name: str, found: torch.Tensor, expected: torch.Tensor) -> None:
    if not torch.equal(found, expected):
        count = int((found != expected).sum())
        raise Finding(f"{name}: {count} of {found.numel()} values differ")
