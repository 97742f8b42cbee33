"""Points to measure at, where errors hide: everywhere, near the surface, on it, in line with edges, and far away."""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np

from sdm.bench.common.meshes import Case

# How many box sizes "far" is, and how many voxels of a 128^3 grid "near" is.
FAR = 10.0
NEAR = 2.0 / 128
MARGIN = 0.1


def generator(case: Case, what: str) -> np.random.Generator:
    """Random numbers that depend on the mesh's name and the purpose alone."""
    return np.random.default_rng([zlib.crc32(case.name.encode()), zlib.crc32(what.encode())])


def uniform(case: Case, count: int) -> np.ndarray:
    """Points (count,3) float32 in the mesh's box and a tenth of its longest edge around it."""
    low, high = case.box
    room = MARGIN * (high - low).max()
    return generator(case, "uniform").uniform(low - room, high + room, (count, 3)).astype(np.float32)


def near(case: Case, count: int) -> np.ndarray:
    """Points within two voxels of a 128^3 grid from the surface."""
    rng = generator(case, "near")
    low, high = case.box
    reach = NEAR * (high - low).max()
    step = _directions(rng, count) * rng.uniform(0, reach, (count, 1))
    return (_on_triangles(case, rng, count) + step).astype(np.float32)


def surface(case: Case, count: int) -> np.ndarray:
    """Points on the surface as near as float32 has them: in triangles, at vertices, at the middles of edges."""
    rng = generator(case, "surface")
    vertices, edges = count // 4, count // 4
    corner = case.vertices.astype(np.float64)[case.faces]
    face, side = rng.integers(0, len(corner), edges), rng.integers(0, 3, edges)
    middles = (corner[face, side] + corner[face, (side + 1) % 3]) / 2
    corners = corner[rng.integers(0, len(corner), vertices), rng.integers(0, 3, vertices)]
    inner = _on_triangles(case, rng, count - vertices - edges)
    return np.concatenate([inner, corners, middles]).astype(np.float32)


def far(case: Case, count: int) -> np.ndarray:
    """Points about ten box sizes away."""
    rng = generator(case, "far")
    low, high = case.box
    reach = FAR * (high - low).max()
    return ((low + high) / 2 + _directions(rng, count) * reach * rng.uniform(0.9, 1.1, (count, 1))).astype(np.float32)


def in_line(case: Case, count: int) -> np.ndarray:
    """Points on the lines of edges, up to half a length beyond their ends, or up to a hundredth beside them."""
    rng = generator(case, "in line")
    corner = case.vertices.astype(np.float64)[case.faces]
    face, side = rng.integers(0, len(corner), count), rng.integers(0, 3, count)
    start, edge = corner[face, side], corner[face, (side + 1) % 3] - corner[face, side]
    points = start + rng.uniform(-0.5, 1.5, (count, 1)) * edge
    off = 10.0 ** rng.uniform(-9, -2, (count, 1)) * np.linalg.norm(edge, axis=1, keepdims=True)
    points[::2] += (off * _directions(rng, count))[::2]
    return points.astype(np.float32)


KINDS: dict[str, Callable[[Case, int], np.ndarray]] = {
    "uniform": uniform,
    "near": near,
    "surface": surface,
    "in line": in_line,
    "far": far,
}


def _on_triangles(case: Case, rng: np.random.Generator, count: int) -> np.ndarray:
    """Half by area, half by number, so that small triangles get their points too."""
    corner = case.vertices.astype(np.float64)[case.faces]
    # Scaled first: areas of huge and tiny meshes leave float64's range otherwise.
    sides = (corner - corner[:, :1]) / max(np.abs(corner - corner[:, :1]).max(), 1e-300)
    area = np.linalg.norm(np.cross(sides[:, 1], sides[:, 2]), axis=1)
    face = rng.integers(0, len(corner), count)
    if area.sum() > 0:
        face[: count // 2] = rng.choice(len(corner), count // 2, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), count)
    return np.einsum("nk,nki->ni", weights, corner[face])


def _directions(rng: np.random.Generator, count: int) -> np.ndarray:
    step = rng.normal(size=(count, 3))
    return step / np.linalg.norm(step, axis=1, keepdims=True)
