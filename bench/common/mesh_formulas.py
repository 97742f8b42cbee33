"""Clean shapes from formulas: float32 vertices (V,3) and int32 faces (F,3), counter-clockwise seen from outside."""

from __future__ import annotations

import numpy as np

Arrays = tuple[np.ndarray, np.ndarray]


def cube(half: float = 1.0) -> Arrays:
    """An axis-aligned cube around the origin: 12 triangles."""
    vertices = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return vertices.astype(np.float32), np.array(faces, np.int32)


def sphere(rings: int = 32, radius: float = 1.0, centre: tuple[float, float, float] = (0, 0, 0)) -> Arrays:
    """A sphere of latitudes and longitudes with a pole at each end: `4 * rings * (rings - 1)` triangles."""
    segments = 2 * rings
    polar = np.pi * np.arange(1, rings) / rings
    turn = 2 * np.pi * np.arange(segments) / segments
    wall = np.stack(
        [
            np.sin(polar)[:, None] * np.cos(turn),
            np.sin(polar)[:, None] * np.sin(turn),
            np.broadcast_to(np.cos(polar)[:, None], (rings - 1, segments)),
        ],
        -1,
    ).reshape(-1, 3)
    vertices = np.concatenate([wall, [[0, 0, 1], [0, 0, -1]]]) * radius + centre
    here = np.arange(segments)
    beside = (here + 1) % segments
    top, bottom, last = len(wall), len(wall) + 1, (rings - 2) * segments
    caps = [np.stack([np.full(segments, top), here, beside], -1)]
    caps += [np.stack([np.full(segments, bottom), last + beside, last + here], -1)]
    return vertices.astype(np.float32), np.concatenate([_strip(rings - 1, segments, False), *caps]).astype(np.int32)


def torus(triangles: int = 4096, radius: float = 0.65, tube: float = 0.25) -> Arrays:
    """A torus of about `triangles` triangles (rounded to `4 * k * k`), up to many millions."""
    tube_segments = max(3, round((triangles / 4) ** 0.5))
    segments = 2 * tube_segments
    turn = 2 * np.pi * np.arange(segments) / segments
    around = 2 * np.pi * np.arange(tube_segments) / tube_segments
    reach = radius + tube * np.cos(around)
    vertices = np.stack(
        [
            np.cos(turn)[:, None] * reach,
            np.sin(turn)[:, None] * reach,
            np.broadcast_to(tube * np.sin(around), (segments, tube_segments)),
        ],
        -1,
    ).reshape(-1, 3)
    return vertices.astype(np.float32), _strip(segments, tube_segments, True).astype(np.int32)


def hemisphere(rings: int = 16) -> Arrays:
    """The upper half of a sphere, open below."""
    vertices, faces = sphere(2 * rings)
    return vertices, faces[(vertices[faces][..., 2] >= -1e-6).all(1)]


def moebius(segments: int = 200, width: int = 8) -> Arrays:
    """A Moebius strip: one side, so no inside anywhere."""
    turn = 2 * np.pi * np.arange(segments) / segments
    across = np.linspace(-0.4, 0.4, width + 1)
    reach = 1 + across * np.cos(turn / 2)[:, None]
    vertices = np.stack(
        [np.cos(turn)[:, None] * reach, np.sin(turn)[:, None] * reach, across * np.sin(turn / 2)[:, None]], -1
    )
    here, step = np.meshgrid(np.arange(segments), np.arange(width), indexing="ij")
    row, side = width + 1, here == segments - 1
    there = (here + 1) % segments
    # The last strip meets the first one upside down.
    near, far = np.where(side, width - step, step), np.where(side, width - step - 1, step + 1)
    a, b = here * row + step, here * row + step + 1
    c, d = there * row + far, there * row + near
    faces = np.concatenate([np.stack([a, d, c], -1).reshape(-1, 3), np.stack([a, c, b], -1).reshape(-1, 3)])
    return vertices.reshape(-1, 3).astype(np.float32), faces.astype(np.int32)


def joined(*parts: Arrays) -> Arrays:
    """Several meshes as one, nothing merged."""
    start = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + at for (_, faces), at in zip(parts, start, strict=False)])
    return vertices.astype(np.float32), faces.astype(np.int32)


def moved(mesh: Arrays, scale: float = 1.0, offset: tuple[float, float, float] = (0, 0, 0)) -> Arrays:
    """Scaled, then shifted, in float64 and rounded once."""
    vertices = mesh[0].astype(np.float64) * scale + np.asarray(offset)
    return vertices.astype(np.float32), mesh[1]


def inverted(mesh: Arrays) -> Arrays:
    """Inside out."""
    return mesh[0], np.ascontiguousarray(mesh[1][:, ::-1])


def _strip(rows: int, columns: int, closed: bool) -> np.ndarray:
    """Two triangles for each cell of a table whose columns, and rows if `closed`, go round."""
    row, column = np.meshgrid(np.arange(rows if closed else rows - 1), np.arange(columns), indexing="ij")
    below, beside = (row + 1) % rows, (column + 1) % columns
    a, b = row * columns + column, row * columns + beside
    c, d = below * columns + beside, below * columns + column
    return np.concatenate([np.stack([a, d, c], -1).reshape(-1, 3), np.stack([a, c, b], -1).reshape(-1, 3)])
