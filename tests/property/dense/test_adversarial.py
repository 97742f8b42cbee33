"""Meshes made to break what the fast dense path takes for granted: ties, needles, tiny triangles far away.

Grids are as fine, and lie as, each mesh makes hardest: on the surface, on planes of symmetry, halfway between surfaces.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

import sdm
from sdm.bench.common.meshes import cube, sphere
from sdm.engine.plan_override import plan_override
from tests.helpers import strategies
from tests.helpers.exactness import assert_exact

few = settings(max_examples=25)


def check(vertices: np.ndarray, faces: np.ndarray, grid: sdm.Grid, most: int = 500, seed: int = 0) -> None:
    vertices, faces = np.asarray(vertices, np.float32), np.asarray(faces, np.int32)
    centres = grid.points().reshape(-1, 3)
    some = np.random.default_rng(seed).permutation(len(centres))[:most]
    for device in ("cpu", "cuda")[: 1 + torch.cuda.is_available()]:
        with plan_override(method="cells"):
            values = sdm.signed_distance_map(sdm.TriangleMesh(vertices, faces), grid, device=device).values
        assert_exact(vertices, faces, centres[some].numpy(), values.reshape(-1).cpu()[some])


def turned(rng: np.random.Generator) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(3, 3)))[0]


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    faces = [np.asarray(faces) + start for (_, faces), start in zip(parts, starts, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def fan(around: int, wave: np.ndarray, tip: float) -> tuple[np.ndarray, np.ndarray]:
    """`around` faces about one corner at height `tip`, closed below by another; the rim at heights `wave`."""
    turn = 2 * np.pi * np.arange(around) / around
    rim = np.stack([np.cos(turn), np.sin(turn), wave], 1)
    at, after = np.arange(around), (np.arange(around) + 1) % around
    up = np.stack([at, after, np.full(around, around)], 1)
    down = np.stack([after, at, np.full(around, around + 1)], 1)
    return np.concatenate([rim, [[0, 0, tip], [0, 0, -0.7]]]), np.concatenate([up, down])


def plate(count: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """A square of 2 count^2 triangles about the origin, in the plane z = 0."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    vertices = np.stack([(i - count / 2) * step, (j - count / 2) * step, 0 * i], -1).reshape(-1, 3)
    number = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = [np.stack(corners, -1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    return vertices, np.concatenate(faces)


def octahedron() -> tuple[np.ndarray, np.ndarray]:
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    faces = [[x, y, z] if (x < 3) ^ (y < 3) ^ (z < 3) else [x, z, y] for x in (0, 3) for y in (1, 4) for z in (2, 5)]
    return vertices, np.array(faces)


@few
@given(
    around=st.sampled_from([3, 7, 31, 32, 33, 50, 200]),
    rise=st.sampled_from([0.0, 1e-9, 1e-7, 1e-6, 1e-4, 1e-2]),
    tip=st.sampled_from([-0.5, -1e-3, -1e-7, 0.0, 1e-7, 1e-5, 1e-2, 0.5, 5.0]),
    reach=st.floats(-4, 0.3),
    seed=strategies.seeds,
)
def test_many_faces_at_a_corner(around, rise, tip, reach, seed):
    """Nearly coplanar fans, saddles, spikes and pits; the grid is above the corner or around it."""
    rng = np.random.default_rng(seed)
    vertices, faces = fan(around, rise * rng.normal(size=around), tip)
    turn = turned(rng) if rng.random() < 0.7 else np.eye(3)
    step = 0.1 * 10.0**reach
    centre = (np.array([0, 0, tip]) + rng.normal(size=3) * [1, 1, rng.choice([1, 30])] * 10.0**reach) @ turn
    check(vertices @ turn, faces, sdm.Grid(centre - 8 * step, [step] * 3, [17, 18, 16]), seed=seed)


@few
@given(
    fold=st.sampled_from([1e-8, 1e-7, 1e-6, 1e-5, 1e-3, 0.1]),
    count=st.integers(1, 6),
    offset=st.floats(-1.2, 1.2),
    size=st.floats(-5, -0.8),
    seed=strategies.seeds,
)
def test_almost_folded_edges(fold, count, offset, size, seed):
    """Sheets that turn back on themselves, `fold` apart at the open end."""
    rng = np.random.default_rng(seed)
    i = np.arange(2 * count + 2)
    rows = [np.stack([i % 2, 0 * i + side, fold * i + fold * 0.1 * rng.normal(size=len(i))], 1) for side in (0, 1)]
    vertices = np.concatenate(rows) - 0.5
    first, second = i[:-1], i[:-1] + len(i)
    faces = np.concatenate([np.stack([first, first + 1, second], 1), np.stack([second, first + 1, second + 1], 1)])
    turn = turned(rng) if rng.random() < 0.7 else np.eye(3)
    step = 10.0**size
    centre = np.array([offset, 0.1, -0.5 + rng.choice([0, 0.3, 1.0]) + fold * count]) @ turn
    check(vertices @ turn, faces, sdm.Grid(centre - 8 * step, [step] * 3, [16, 17, 18]), seed=seed)


@few
@given(
    width=st.sampled_from([1e-7, 1e-6, 1e-5, 1e-3]),
    size=st.floats(-6, -0.5),
    seed=strategies.seeds,
)
@example(width=1e-7, size=-1.9, seed=1950730)
def test_strips_of_needles(width, size, seed):
    """Long needles side by side, in a plane or nearly so, and a far surface that is as near as they are.

    In the example a voxel beyond a needle's tip was once taken to project into it.
    """
    rng = np.random.default_rng(seed)
    count = 40
    i = np.arange(count)
    ends = [np.stack([side + 0 * i, width * i, 0.1 * width * rng.normal(size=count)], 1) for side in (-0.6, 0.6)]
    first, second = i[:-1], i[:-1] + count
    faces = np.concatenate([np.stack([first, second, first + 1], 1), np.stack([first + 1, second, second + 1], 1)])
    away = rng.uniform(0.05, 0.8)
    lid = np.array([[-1, -1, 2 * away], [1, -1, 2 * away], [0, 1, 2 * away]]), np.array([[0, 1, 2]])
    turn = turned(rng)
    step = 10.0**size
    vertices, faces = joined((np.concatenate(ends), faces), lid)
    centre = np.array([rng.uniform(-0.7, 0.7), width * count / 2, away]) @ turn
    check(vertices @ turn, faces, sdm.Grid(centre - 8 * step, [step] * 3, [16, 16, 16]), seed=seed)


@settings(max_examples=12)
@given(fine=st.floats(-4.5, -1.5), seed=strategies.seeds)
def test_between_a_fine_plate_and_a_far_triangle(fine, seed):
    """Both as near: rounding that turns a small triangle's edges must not lose it (it did)."""
    rng = np.random.default_rng(seed)
    up = np.ones(3) / 3**0.5
    side = np.cross(up, rng.normal(size=3))
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(up, side), up])
    away = 1.06 * 3**0.5
    vertices, faces = plate(16, away * 10.0**fine)
    far = np.array([[-0.1, -0.1, away], [0.1, -0.1, away], [0, 0.2, away]]) @ turn + 0.11
    vertices, faces = joined((vertices @ turn - 0.95, faces), (far, np.array([[0, 1, 2]])))
    step = away * 10.0**fine / 20
    check(vertices, faces, sdm.Grid([0.11 - 19.5 * step] * 3, [step] * 3, [40] * 3), 2000, seed)


def test_between_a_fine_plate_and_a_far_triangle_here():
    """One case of those above, which went wrong in 28 of 64,000 voxels."""
    rng = np.random.default_rng(0)
    up = np.ones(3) / 3**0.5
    side = rng.normal(size=3)
    side -= side @ up * up
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(up, side), up])
    away = 1.06 * 3**0.5
    vertices, faces = plate(16, 3e-4 * away)
    far = np.array([[-0.1, -0.1, away], [0.1, -0.1, away], [0, 0.2, away]]) @ turn + 0.11
    vertices, faces = joined((vertices @ turn - 0.95, faces), (far, np.array([[0, 1, 2]])))
    step = 3e-4 * away / 20
    origin = 0.11 - 19.5 * step + step * np.array([8, 24, 0])
    check(vertices, faces, sdm.Grid(origin, [step] * 3, [16, 16, 8]), 2048)


@pytest.mark.parametrize("seed", [7, 35, 529, 547, 3710, 4258, 4699])
def test_at_the_end_of_a_long_edge(seed):
    """A ridge that ends at small triangles, in a small block with a voxel hardly within its ends (lost once).

    A lid above is about as near, so that there is something wrong to be found.
    """
    rng = np.random.default_rng(seed)
    long, short, height, step = rng.uniform(0.6, 1), 2e-4, 1e-4, 2e-6
    within = 10 ** rng.uniform(-9, -8)
    above = 2 * height + rng.uniform(-1e-5, 1e-5)
    turn = turned(rng)
    turn[2] *= np.sign(np.linalg.det(turn))
    ridge = [[0, 0, 0], [long, 0, 0], [-0.5 * short, short, -short], [-0.5 * short, -short, -short]]
    lid = [[-1e-3, -1e-3, above], [1e-3, -1e-3, above], [0, 1e-3, above]]
    vertices = (np.array(ridge + lid) @ turn).astype(np.float32)
    along = vertices[1].astype(np.float64) / np.linalg.norm(vertices[1].astype(np.float64))
    up = turn[2] - turn[2] @ along * along
    up /= np.linalg.norm(up)
    origin = within * along + height * up - np.where(along > 0, 0, 7) * step
    check(
        vertices, np.array([[0, 2, 3], [0, 1, 2], [0, 3, 1], [4, 5, 6]]), sdm.Grid(origin, [step] * 3, [8, 8, 8]), 512
    )


@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e-10, 1e-13, 1e-15, 1e-16, 1e-18, 1e-22, 1e-28, 1e-38])
@pytest.mark.parametrize("shape", ["octahedron", "sphere"])
def test_tiny_beside_huge(shape, size):
    """Smaller than float64 can tell from afar (it came out as near everywhere), also seen along its diagonals."""
    small, faces = octahedron() if shape == "octahedron" else sphere(6)
    vertices, faces = joined((np.asarray(cube()[0], float), cube()[1]), (small * size, faces))
    check(vertices, faces, sdm.Grid([-0.32] * 3, [0.04] * 3, [17] * 3), 1500)


@few
@given(
    shape=st.sampled_from(["cube", "octahedron", "sphere", "two cubes"]),
    steps=st.sampled_from([4, 6, 8, 14, 20]),
    shift=st.sampled_from([0.0, 0.0, 0.5, 1e-7]),
    offset=st.sampled_from([0.0, 0.0, 1.0, 7.0]),
    diagonal=st.booleans(),
    seed=strategies.seeds,
)
def test_voxels_on_the_surface_and_on_planes_of_symmetry(shape, steps, shift, offset, diagonal, seed):
    """Ties of every kind, also along the diagonals of a cube."""
    vertices, faces = {
        "cube": cube,
        "octahedron": octahedron,
        "sphere": lambda: sphere(6),
        "two cubes": lambda: joined(cube(), (cube()[0] + [2, 0, 0], cube()[1])),
    }[shape]()
    step = 2.0 / steps
    centre = np.full(3, offset)
    count = np.array([steps + 9, steps + 8, steps + 9])
    turn = np.eye(3)
    if diagonal:
        # The grid's third axis along the diagonal (1,1,1).
        turn = np.stack([[1, -1, 0], [1, 1, -2], [1, 1, 1]], 1) / np.sqrt([2, 6, 3])
    origin = centre + turn @ ((shift - (steps + 8) // 2) * np.full(3, step))
    check(vertices + centre, faces, sdm.Grid(origin, [step] * 3, count.tolist(), turn), 800, seed)


@few
@given(
    height=st.floats(-2.5, -0.3),
    apart=st.floats(-8, -5.5),
    size=st.floats(-7, -4),
    seed=strategies.seeds,
)
def test_large_sheets_a_few_roundings_apart(height, apart, size, seed):
    """Roundings decide which is dropped for a fine grid above them: those of their corners, far away."""
    rng = np.random.default_rng(seed)
    corner = rng.uniform(-1, 1, (12, 3, 3)) * rng.choice([1, 1, 0.1], (12, 1, 1))
    corner[..., 2] = 10.0**apart * rng.normal(size=(12, 3))
    turn = turned(rng)
    step = 10.0**size
    foot = np.array([*rng.uniform(-0.2, 0.2, 2), 10.0**height]) @ turn
    vertices = corner.reshape(-1, 3) @ turn / 1.75
    check(vertices, np.arange(36).reshape(-1, 3), sdm.Grid(foot / 1.75 - 6 * step, [step] * 3, [12] * 3), seed=seed)
