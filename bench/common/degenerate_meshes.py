"""Meshes that break mesh code, each small enough for a brute force: see the names."""

from __future__ import annotations

import itertools

import numpy as np

from sdm.bench.common.mesh_formulas import Arrays, cube, joined, moved, sphere, torus


def needle_box(aspect: float = 1e6) -> Arrays:
    """A closed box a million times longer than wide: twelve slivers and right triangles."""
    vertices, faces = cube()
    return (vertices * np.array([1, 1 / aspect, 1 / aspect])).astype(np.float32), faces


def sliver_sphere(aspect: float = 1e6, count: int = 600) -> Arrays:
    """A sphere with loose slivers of the given aspect stuck through it."""
    rng = np.random.default_rng(11)
    start = rng.normal(size=(count, 3))
    end = start + rng.normal(size=(count, 3))
    third = start + rng.uniform(size=(count, 1)) * (end - start)
    third += rng.normal(size=(count, 3)) * np.linalg.norm(end - start, axis=1, keepdims=True) / aspect
    return joined(sphere(16), _loose(np.stack([start, end, third], 1)))


def needle_fan(needles: int = 2000) -> Arrays:
    """A closed double cone whose faces are all needles that meet in two tips."""
    turn = 2 * np.pi * np.arange(needles) / needles
    rim = np.stack([np.cos(turn), np.sin(turn), np.zeros(needles)], -1) * 0.05
    vertices = np.concatenate([rim, [[0, 0, 1], [0.3, 0, -1]]])
    here = np.arange(needles)
    beside = (here + 1) % needles
    up = np.stack([here, beside, np.full(needles, needles)], -1)
    down = np.stack([beside, here, np.full(needles, needles + 1)], -1)
    return vertices.astype(np.float32), np.concatenate([up, down]).astype(np.int32)


def unmerged_sphere() -> Arrays:
    """A sphere as an STL file holds it: three own vertices for each face."""
    vertices, faces = sphere(20)
    return _loose(vertices[faces])


def zero_area_faces() -> Arrays:
    """A torus with points, segments and collinear triangles among its faces, some far off its surface."""
    vertices, faces = torus(2048)
    rng = np.random.default_rng(3)
    a, b = rng.integers(0, len(vertices), (2, 200))
    flat = np.concatenate([np.stack([a, a, a], -1), np.stack([a, a, b], -1), np.stack([a, b, b], -1)])
    # Halves and quarters of one vector are exact, so these are collinear to the last bit.
    corner = np.float32(1.5) * np.array([[0, 0, 0], [1, 0.5, 0.25], [0.5, 0.25, 0.125]], np.float32)
    stick = (corner - np.array([0, 0, 0.5], np.float32), np.array([[0, 1, 2], [0, 2, 1]], np.int32))
    return joined((vertices, np.concatenate([flat[:300], faces, flat[300:]]).astype(np.int32)), stick)


def repeated_faces() -> Arrays:
    """A sphere with a third of its faces twice, and some of those the other way round."""
    vertices, faces = sphere(20)
    return vertices, np.concatenate([faces, faces[::3], faces[1::9, ::-1]]).astype(np.int32)


def collinear_soup(count: int = 400) -> Arrays:
    """Nothing but segments and points: distances are defined, an inside is not."""
    rng = np.random.default_rng(7)
    a, step = rng.integers(-64, 64, (2, count, 1, 3)) / 64
    weights = rng.integers(0, 5, (count, 3, 1)) / 4
    return _loose((a + weights * step).astype(np.float32))


def random_soup(count: int = 1500) -> Arrays:
    """Loose random triangles of all sizes."""
    rng = np.random.default_rng(8)
    size = 10.0 ** rng.uniform(-4, 0, (count, 1, 1))
    return _loose(rng.uniform(-1, 1, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3)))


def repeated_vertex_soup(count: int = 1500) -> Arrays:
    """Random triangles over few vertices: repeated corners, repeated faces, shared edges in all directions."""
    rng = np.random.default_rng(9)
    return rng.normal(size=(24, 3)).astype(np.float32), rng.integers(0, 24, (count, 3)).astype(np.int32)


def t_junctions() -> Arrays:
    """A cube one of whose faces has a vertex in the middle of an edge that its neighbour does not have."""
    vertices, faces = cube()
    vertices = np.concatenate([vertices, [[1, 0, 1]]]).astype(np.float32)
    # The edge from vertex 5 (1,-1,1) to 7 (1,1,1) belongs to faces (4,7,5) and (1,5,7): split it in one of them.
    split = [face for face in faces.tolist() if face != [4, 7, 5]] + [[4, 7, 8], [4, 8, 5]]
    return vertices, np.array(split, np.int32)


def filled_t_junctions(splits: int = 12, seed: int = 4) -> Arrays:
    """A closed prism, turned, one of whose edges is whole on one side and split on the other.

    Thin triangles fill what rounding left between: from one end of the edge to each piece of it.
    """
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    base = np.array([[1.0, 0.0], [-0.5, 0.8], [-0.6, -0.7]])
    vertices = np.concatenate([np.insert(base, 2, z, axis=1) for z in (-1.5, 1.5)])
    share = np.sort(rng.uniform(0, 1, (splits, 1)), axis=0)
    vertices = np.concatenate([vertices, vertices[0] + share * (vertices[3] - vertices[0])]) @ turn
    if np.linalg.det(turn) < 0:
        vertices = -vertices
    chain = [0, *range(6, 6 + splits), 3]
    # The side (0,1,4,3) is whole, the side (2,0,3,5) is a fan from vertex 2 over the pieces, and from 5 over its end.
    faces = [[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 3, 5]]
    pieces = list(itertools.pairwise(chain))
    faces += [[2, begin, end] for begin, end in pieces]
    faces += [[0, end, begin] for begin, end in pieces[1:]]
    return vertices.astype(np.float32), np.array(faces, np.int32)


def thin_soup(rng: np.random.Generator, count: int) -> np.ndarray:
    """Corners (count,3,3) float32 of loose near-degenerate triangles, of many heights, alone or on one turned line."""
    start, along = rng.normal(size=(2, count, 1, 3))
    if rng.random() < 0.5:
        start, along = start[:1], along[:1]
    corner = start + rng.uniform(-1, 1, (count, 3, 1)) * along
    if rng.random() < 0.3:
        # Needles from one tip.
        corner[:, 0] = corner[0, 0]
    if rng.random() < 0.3:
        corner *= 10.0 ** rng.uniform(-3, 0, (count, 1, 1))
    off = rng.normal(size=(count, 3, 3)) * 10.0 ** rng.uniform(-9, -1, (count, 1, 1))
    return (corner + (rng.random() < 0.6) * off).astype(np.float32)


def thin_soups(clusters: int = 125, seed: int = 13) -> Arrays:
    """Many soups of one to five near-degenerate triangles, each by itself."""
    rng = np.random.default_rng(seed)
    side = round(clusters ** (1 / 3))
    place = 8.0 * np.stack(np.meshgrid(*[np.arange(side) - side / 2] * 3), -1).reshape(-1, 1, 1, 3)
    soups = [thin_soup(rng, int(rng.integers(1, 6))) + offset for offset in place]
    return _loose(np.concatenate(soups))


def three_sheets() -> Arrays:
    """Three wings that meet at one edge, and two cubes that share an edge: no manifold."""
    turn = 2 * np.pi * np.arange(3) / 3
    tip = np.stack([np.cos(turn), np.sin(turn)], -1)
    vertices = [[0, 0, -1], [0, 0, 1]] + [[x, y, z] for x, y in tip for z in (-1, 1)]
    faces = [face for k in (2, 4, 6) for face in ([0, k, k + 1], [0, k + 1, 1])]
    wings = np.array(vertices, np.float32), np.array(faces, np.int32)
    return joined(wings, moved(cube(0.5), offset=(3, 0, 0)), moved(cube(0.5), offset=(4, 1, 0)))


def tiny_beside_huge() -> Arrays:
    """A box of twelve huge triangles with spheres 3000 times smaller on it, in it and beside it."""
    places = [(1.0, 0.2, 0.3), (0.1, 0.2, 0.9996), (1.0005, 1.0005, 1.0005), (0, 0, 0), (1.6, -1.2, 0)]
    return joined(cube(), *(sphere(6, 1 / 3000, place) for place in places))


def _loose(corner: np.ndarray) -> Arrays:
    count = len(corner)
    return corner.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(count, 3)
