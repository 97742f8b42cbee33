"""Hypothesis strategies for meshes that break mesh code, and for the points worth asking about.

Half of all meshes have their vertices on a small lattice of integers, where ties of every kind are exact: coincident,
collinear and zero-area triangles, rays through edges and corners, points at equal distances.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sdm.bench.common.meshes import cube, sphere


class Arrays(NamedTuple):
    """A mesh: vertices (V,3) float32 and faces (F,3) int32."""

    vertices: np.ndarray
    faces: np.ndarray


lattice = st.integers(-3, 3).map(float)
reals = st.floats(-1, 1, width=32, allow_subnormal=False)


@st.composite
def vertices(draw: st.DrawFn, fewest: int = 3, most: int = 12) -> np.ndarray:
    """(V,3) float32, on the lattice or anywhere within -1..1; equal ones are likely."""
    count = draw(st.integers(fewest, most))
    elements = draw(st.sampled_from([lattice, reals]))
    return draw(hnp.arrays(np.float32, (count, 3), elements=elements))


@st.composite
def soups(draw: st.DrawFn, most: int = 16) -> Arrays:
    """Any triangles over few vertices: repeated corners, repeated faces, three faces at an edge."""
    corners = draw(vertices())
    count = draw(st.integers(1, most))
    faces = draw(hnp.arrays(np.int32, (count, 3), elements=st.integers(0, len(corners) - 1)))
    return Arrays(corners, faces)


@st.composite
def slivers(draw: st.DrawFn, most: int = 12) -> Arrays:
    """Loose triangles, most of them needles: the third corner lies on the opposite edge, exactly or nearly."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, most))
    ends = rng.normal(size=(count, 2, 3))
    share = rng.choice([0, 0.25, 0.5, 1, 2], (count, 1))
    off = rng.normal(size=(count, 3)) * rng.choice([0, 1e-12, 1e-8, 1e-6, 1e-3, 1], (count, 1))
    third = ends[:, 0] + share * (ends[:, 1] - ends[:, 0]) + off
    corner = np.concatenate([ends, third[:, None]], 1)
    return Arrays(corner.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3))


@st.composite
def closed(draw: st.DrawFn, most: int = 8) -> Arrays:
    """Boundaries of random tetrahedra over few vertices: closed, with shells that nest, touch, overlap, invert."""
    corners = draw(vertices(fewest=4))
    count = draw(st.integers(1, most))
    tetrahedra = draw(hnp.arrays(np.int32, (count, 4), elements=st.integers(0, len(corners) - 1)))
    sides = ([0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2])
    return Arrays(corners, np.concatenate([tetrahedra[:, side] for side in sides]))


@st.composite
def shells(draw: st.DrawFn, most: int = 4) -> Arrays:
    """Cubes and spheres of sizes and places on a coarse lattice: nested, touching, overlapping, inverted."""
    parts = []
    for _ in range(draw(st.integers(1, most))):
        shape, faces = draw(st.sampled_from([cube(), cube(), sphere(4)]))
        size = draw(st.sampled_from([0.5, 1.0, 2.0]))
        place = draw(hnp.arrays(np.float32, 3, elements=st.integers(-3, 3).map(float)))
        parts.append((np.float32(size) * shape + place, faces[:, ::-1] if draw(st.booleans()) else faces))
    starts = np.cumsum([0] + [len(part) for part, _ in parts[:-1]])
    joined = np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=True)])
    return Arrays(np.concatenate([part for part, _ in parts]).astype(np.float32), joined.astype(np.int32))


# Any seed of the points below: they matter less than the mesh, so they need not shrink.
seeds = st.integers(0, 2**32 - 1)


def points_about(mesh: Arrays, seed: int, count: int = 48) -> np.ndarray:
    """Points (N,3) float32 of every kind: around the mesh, on its lattice, on it, near it, in line with its corners."""
    rng = np.random.default_rng(seed)
    used = mesh.vertices[mesh.faces].astype(np.float64)
    low, high = used.min((0, 1)), used.max((0, 1))
    size = max(float((high - low).max()), float(np.abs(used).max()) * 1e-3) or 1.0
    kinds: list[Callable[[], np.ndarray]] = [
        lambda: rng.uniform(low - 0.5 * size, high + 0.5 * size, (count, 3)),
        lambda: low + 10 * size * rng.normal(size=(count, 3)),
        lambda: rng.integers(-8, 9, (count, 3)) / 2.0 * (1.0 if size >= 1 else size / 4) + np.round(low),
        lambda: _on(used, rng, count),
        lambda: _on(used, rng, count) + size * 10.0 ** rng.uniform(-7, -2, (count, 1)) * rng.normal(size=(count, 3)),
        lambda: _in_line(used, rng, count, size),
        lambda: used[rng.integers(0, len(used), count), rng.integers(0, 3, count)],
    ]
    share = count // len(kinds) + 1
    return np.concatenate([kind()[:share] for kind in kinds])[:count].astype(np.float32)


def _on(corner: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    weights = rng.dirichlet([1, 1, 1], count)
    # A third of them on edges.
    weights[::3, 0] = 0
    weights /= weights.sum(1, keepdims=True)
    return (weights[:, None] @ corner[rng.integers(0, len(corner), count)])[:, 0]


def _in_line(corner: np.ndarray, rng: np.random.Generator, count: int, size: float) -> np.ndarray:
    """Exactly equal to a corner, or nearly so, in all coordinates but one or two."""
    points = corner[rng.integers(0, len(corner), count), rng.integers(0, 3, count)]
    moved = rng.integers(0, 3, count)
    points[np.arange(count), moved] += 2 * size * rng.normal(size=count)
    points[::2] += size * 10.0 ** rng.uniform(-13, -6, (len(points[::2]), 1)) * rng.normal(size=(len(points[::2]), 3))
    return points


# Sizes and places that a mesh may have: powers of two are exact, others round.
scales = st.sampled_from([1.0, 1.0, 2.0**-66, 2.0**66, 1e-20, 1e20, 1e-5, 3e4])
offsets = st.sampled_from([0.0, 0.0, 1.0, 10.0, 1e4])


@st.composite
def anywhere(draw: st.DrawFn, meshes: st.SearchStrategy[Arrays]) -> Arrays:
    """The same meshes, of any size and far from the origin."""
    corners, faces = draw(meshes)
    offset = draw(offsets) * np.array([1.0, -0.7, 0.3])
    return Arrays(((corners + offset) * draw(scales)).astype(np.float32), faces)
