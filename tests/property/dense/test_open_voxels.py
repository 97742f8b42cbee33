"""Winding numbers of open meshes on grids: at every voxel on the side of 0.25, 0.5 and 0.75 where the plain one is.

What `kernels/winding/open_caps.py` gives may be rounded; the plain one adds up every boundary edge for every point in
float64.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

import sdm
from sdm.bench.common.meshes import sphere
from sdm.engine.acceleration import as_warp, build
from sdm.kernels.geometry.voxel_grid import Slab
from sdm.kernels.winding.column_sums import slab_winding
from sdm.runtime.torch_warp import workspace
from tests.helpers import oracle

CPU = torch.device("cpu")
# Where the winding number is that near to a limit, either side is right.
TIE = 1e-6


def on_slab(vertices: np.ndarray, faces: np.ndarray, grid: sdm.Grid, begin: int = 0) -> np.ndarray:
    """Winding numbers that the kernels find for meshes (B,V,3) from layer `begin` on."""
    structure = build(torch.from_numpy(np.ascontiguousarray(vertices)), torch.from_numpy(faces))
    tree, winding, *_ = structure.view
    slab = Slab()
    slab.origin, slab.spacing = wp.vec3d(*grid.origin), wp.vec3d(*grid.spacing)
    slab.shape, slab.first = wp.vec3i(grid.shape[0] - begin, *grid.shape[1:]), begin
    values = torch.empty((len(vertices), grid.shape[0] - begin, *grid.shape[1:]))
    slab_winding(tree, winding, slab, as_warp(values, wp.float32), workspace(CPU))
    return values.numpy()


def assert_same_sides(found: np.ndarray, expected: np.ndarray) -> None:
    for limit in (0.25, 0.5, 0.75):
        sure = np.abs(expected - limit) > TIE
        wrong = sure & ((found > limit) != (expected > limit))
        assert not wrong.any(), (limit, wrong.sum(), found[wrong][:4], expected[wrong][:4])


def check(vertices: np.ndarray, faces: np.ndarray, grid: sdm.Grid) -> np.ndarray:
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu")
    assert not index.closed
    expected = index.winding_number(grid.points()).numpy()
    assert_same_sides(on_slab(vertices[None], faces, grid)[0], expected)
    return expected


def grids(vertices: np.ndarray, faces: np.ndarray, rng: np.random.Generator) -> list[sdm.Grid]:
    """Around all; unequal and odd; and a small one about a vertex."""
    low, high = vertices.min(0).astype(float), vertices.max(0).astype(float)
    size = float((high - low).max())
    step = size / rng.uniform(15, 30)
    at = vertices[rng.integers(len(vertices))].astype(float)
    fine = size * 10 ** rng.uniform(-7, -1.5)
    return [
        sdm.Grid.around(sdm.TriangleMesh(vertices, faces), resolution=33, margin=0.2)
        if (high > low).all()
        else sdm.Grid(tuple(low - 4 * step), (step, step, step), (33, 35, 9)),
        sdm.Grid(tuple(low - size * rng.uniform(0, 0.5, 3)), tuple(step * rng.uniform(0.5, 1.5, 3)), (37, 13, 22)),
        sdm.Grid(tuple(at - 6.5 * fine), (fine, fine, fine), (14, 14, 14)),
    ]


def holes(rng: np.random.Generator, radii: list[float], near: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """A sphere without the faces around some places, which are side by side if `near`."""
    vertices, faces = sphere(24)
    middle = vertices[faces].mean(1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    first = rng.normal(size=3)
    gone = np.zeros(len(faces), bool)
    for number, radius in enumerate(radii):
        at = first + number * 0.5 * rng.normal(size=3) if near else rng.normal(size=3)
        gone |= np.arccos(np.clip(middle @ (at / np.linalg.norm(at)), -1, 1)) < radius
    return vertices, faces[~gone]


def sheet(rng: np.random.Generator, bent: float) -> tuple[np.ndarray, np.ndarray]:
    count = 9
    x, y = np.meshgrid(np.linspace(-1, 1, count), np.linspace(-1, 1, count), indexing="ij")
    z = bent * rng.normal(size=x.shape)
    at = np.arange(count * count).reshape(count, count)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    return np.stack([x, y, z], -1).reshape(-1, 3).astype(np.float32), faces


def flipped(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A sphere with some faces inside out, whose edges count twice, and some there twice."""
    vertices, faces = sphere(10)
    some = rng.choice(len(faces), count, replace=False)
    faces[some] = faces[some][:, ::-1]
    return vertices, np.concatenate([faces, faces[rng.choice(len(faces), count)]])


MAKERS = {
    "several holes": lambda rng: holes(rng, [0.1, 0.2, 0.35, 0.5, 0.15]),
    "holes side by side": lambda rng: holes(rng, [0.15, 0.2, 0.2, 0.1], near=True),
    "one large hole": lambda rng: holes(rng, [rng.uniform(1.2, 2.6)]),
    "flat sheet": lambda rng: sheet(rng, 0.0),
    "bent sheet": lambda rng: sheet(rng, 0.3),
    "flipped faces": lambda rng: flipped(rng, 12),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", MAKERS)
def test_every_voxel_is_on_the_right_side(name, seed):
    rng = np.random.default_rng([seed, *name.encode()])
    vertices, faces = MAKERS[name](rng)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    if seed > 0:
        vertices = (vertices @ turn.T + 3 * rng.normal(size=3)).astype(np.float32)
    unclear = 0
    for grid in grids(vertices, faces, rng):
        unclear += int((np.abs(check(vertices, faces, grid) - 0.5) < 0.25).sum())
    assert unclear > 0


@pytest.mark.parametrize("offset", [0.0, 0.4])
def test_caps_in_a_plane_of_voxels(offset):
    """A flat hole whose cap holds a layer of voxel centres, along each axis in turn."""
    vertices, faces = sphere(12)
    faces = faces[(vertices[faces][:, :, 2] > 0.05).any(1) | (vertices[faces][:, :, 2] > -1e-6).all(1)]
    for axis in range(3):
        turned = np.roll(vertices, axis, 1)
        step = 0.1
        grid = sdm.Grid((-1.2 + offset * step,) * 3, (step,) * 3, (25, 25, 25))
        check(np.ascontiguousarray(turned), faces, grid)


def test_agrees_with_every_triangle_added_up():
    vertices, faces = holes(np.random.default_rng(5), [0.3, 0.6])
    grid = sdm.Grid((-1.11, -1.08, -1.13), (0.15, 0.16, 0.14), (16, 16, 17))
    expected = oracle.winding_number(vertices, faces, grid.points().reshape(-1, 3).numpy()).reshape(grid.shape)
    assert_same_sides(on_slab(vertices[None], faces, grid)[0], expected)


def test_each_mesh_of_a_batch_and_each_slab_by_itself():
    rng = np.random.default_rng(7)
    vertices, faces = holes(rng, [0.3, 0.2, 0.4])
    batch = np.stack([vertices, 0.5 * vertices + 0.3, vertices @ np.diag([1.0, 0.4, 0.7]).astype(np.float32)])
    grid = sdm.Grid((-1.1, -1.1, -1.1), (0.1, 0.1, 0.1), (37, 22, 23))
    together = on_slab(batch.astype(np.float32), faces, grid)
    for mesh, values in zip(batch, together, strict=True):
        assert np.array_equal(on_slab(mesh[None].astype(np.float32), faces, grid)[0], values)
    assert np.array_equal(on_slab(batch.astype(np.float32), faces, grid, begin=32), together[:, 32:])


@pytest.mark.gpu
@pytest.mark.parametrize("name", MAKERS)
def test_a_gpu_agrees(name):
    rng = np.random.default_rng([4, *name.encode()])
    vertices, faces = MAKERS[name](rng)
    mesh = sdm.TriangleMesh(vertices, faces)
    for grid in grids(vertices, faces, rng):
        winding = sdm.MeshIndex(mesh, "cpu").winding_number(grid.points())
        field = sdm.MeshIndex(mesh, "cuda").signed_distance_map(grid)
        sure = (winding - 0.5).abs() > TIE
        assert torch.equal((field.values.cpu() < 0)[sure], (winding > 0.5)[sure])
        off = (winding - 0.5).abs()
        assert int((off < 0.25 - TIE).sum()) <= field.ambiguous_voxels <= int((off < 0.25 + TIE).sum())
