"""Dirty meshes by code: torn, opened, turned, in loose sheets, with doubled walls, through each other, shuffled."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sdm.bench.common.degenerate_meshes import needle_box
from sdm.bench.common.mesh_formulas import Arrays, cube, hemisphere, inverted, joined, moved, sphere, torus


def torn(mesh: Arrays, share: float, seed: int = 0) -> Arrays:
    """A mesh without a share of its faces, anywhere."""
    vertices, faces = mesh
    return vertices, faces[np.random.default_rng(seed).random(len(faces)) >= share]


def turned(mesh: Arrays, share: float, seed: int = 0) -> Arrays:
    """A mesh with a share of its faces inside out."""
    vertices, faces = mesh
    faces = faces.copy()
    chosen = np.random.default_rng(seed).random(len(faces)) < share
    faces[chosen] = faces[chosen][:, ::-1]
    return vertices, faces


def slit(mesh: Arrays, width: float) -> Arrays:
    """A mesh without the faces whose middle is within half a width of the plane z = 0.1, but for one corner of it."""
    vertices, faces = mesh
    middle = vertices[faces].mean(1)
    gone = (np.abs(middle[:, 2] - 0.1) < width / 2) & (middle[:, 0] < 0.5)
    return vertices, faces[~gone]


def half_spheres(count: int, rings: int = 15, seed: int = 0) -> Arrays:
    """Open bowls of one size, here and there, turned at random."""
    vertices, faces = sphere(rings)
    faces = faces[(vertices[faces][:, :, 2] > -1e-6).all(1)]
    rng = np.random.default_rng(seed)
    places = [0.1 * vertices @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + rng.uniform(-1, 1, 3) for _ in range(count)]
    index = [faces + len(vertices) * number for number in range(count)]
    return np.concatenate(places).astype(np.float32), np.concatenate(index).astype(np.int32)


def loose(mesh: Arrays, gap: float = 0.0, seed: int = 0) -> Arrays:
    """Faces in any order with vertices of their own, each moved by about `gap`, and its corners named in any order."""
    rng = np.random.default_rng(seed)
    vertices, faces = mesh
    corners = vertices[rng.permutation(faces)]
    corners = corners + gap * rng.normal(size=(len(faces), 1, 3))
    index = np.arange(3 * len(faces)).reshape(-1, 3)
    turn = (np.arange(3) + rng.integers(3, size=(len(faces), 1))) % 3
    return corners.reshape(-1, 3).astype(np.float32), np.take_along_axis(index, turn, 1).astype(np.int32)


def sheet(size: np.ndarray, steps: int = 4) -> Arrays:
    """A flat rectangle across z."""
    x, y = np.meshgrid(*[np.linspace(-0.5, 0.5, steps)] * 2, indexing="ij")
    at = np.arange(steps * steps).reshape(steps, steps)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    vertices = np.stack([size[0] * x, size[1] * y, 0 * x], -1).reshape(-1, 3)
    return vertices.astype(np.float32), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(
        np.int32
    )


def sheets(count: int, seed: int = 0) -> Arrays:
    """Separate sheets along the axes, as cars and trucks are made of: one-sided, of all sizes, facing either way."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(count):
        vertices, faces = sheet(rng.uniform(0.2, 1.2, 2))
        vertices = np.roll(vertices, rng.integers(3), 1) + rng.uniform(-0.6, 0.6, 3).astype(np.float32)
        parts.append((vertices, faces[:, ::-1] if rng.random() < 0.3 else faces))
    return joined(*parts)


def boxes(count: int, seed: int = 0) -> Arrays:
    """Boxes without lids, through each other."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(count):
        vertices, faces = cube()
        vertices = (vertices * rng.uniform(0.1, 0.5, 3) + rng.uniform(-0.6, 0.6, 3)).astype(np.float32)
        parts.append((vertices, faces[2:]))
    return joined(*parts)


def doubled(mesh: Arrays, thickness: float) -> Arrays:
    """Walls of two sides: a mesh, and itself inside out a little smaller."""
    return joined(mesh, inverted(moved(mesh, 1 - thickness)))


# By name: small ones, for the accuracy report and tests.
DIRTY: dict[str, tuple[Callable[[], Arrays], str]] = {
    "torus less 1 %": (lambda: torn(torus(), 0.01), "open"),
    "torus less 3 %": (lambda: torn(torus(), 0.03), "open"),
    "torus less 10 %": (lambda: torn(torus(), 0.1), "open"),
    "torus less 30 %": (lambda: torn(torus(), 0.3), "open"),
    "torus less 70 %": (lambda: torn(torus(), 0.7), "open soup"),
    "torus, a tenth turned": (lambda: turned(torus(), 0.1), "open"),
    "torus, half turned": (lambda: turned(torus(), 0.5), "open soup"),
    "torus, half turned, less 20 %": (lambda: torn(turned(torus(), 0.5), 0.2), "open soup"),
    "sphere with a slit": (lambda: slit(sphere(24), 0.1), "open"),
    "sphere with a slit, less 5 %": (lambda: torn(slit(sphere(24), 0.1), 0.05), "open"),
    "10 half spheres": (lambda: half_spheres(10, 8), "open"),
    "100 half spheres": (lambda: half_spheres(100, 5), "open"),
    "shuffled torus": (lambda: loose(torus()), "closed"),
    "shuffled torus, half turned": (lambda: turned(loose(torus()), 0.5), "open soup"),
    "loose torus": (lambda: loose(torus(), 0.004), "open"),
    "60 sheets": (lambda: sheets(60), "open soup"),
    "200 sheets": (lambda: sheets(200, 1), "open soup"),
    "open boxes": (lambda: boxes(40), "open"),
    "doubled walls": (lambda: doubled(hemisphere(12), 0.05), "open"),
    "doubled walls less 10 %": (lambda: torn(doubled(sphere(20), 0.02), 0.1), "open"),
    "crossing parts less 5 %": (lambda: torn(joined(sphere(20), moved(torus(2048), 1.2, (0.7, 0, 0.1))), 0.05), "open"),
    "crossing bowls": (lambda: joined(hemisphere(10), moved(hemisphere(10), 0.8, (0.3, 0.2, -0.2))), "open"),
    "nested shells less 20 %": (lambda: torn(joined(sphere(20), moved(sphere(16), 0.6)), 0.2), "open"),
    "needle box less 10 %": (lambda: torn(needle_box(), 0.1), "open sliver"),
    "repeated and torn": (lambda: torn(joined(sphere(16), sphere(16), sphere(16)), 0.2), "open degenerate"),
}
