"""Cones of normals: the way from the nearest surface point to any place is in its owner's cone, and in all above it."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from sdm.bench.common.meshes import sphere
from sdm.engine.acceleration import build
from sdm.kernels.bvh.tree import Tree, node_box
from sdm.kernels.culling.normal_cones import LEVELS, MOST_AROUND, Cones, cone_misses, merged
from sdm.kernels.geometry.voxel_box import VoxelBox
from sdm.kernels.primitives.vector_loads import load4
from tests.helpers import oracle

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _misses(
    tree: Tree,
    balls: wp.array(dtype=wp.float32),
    cones: Cones,
    centre: wp.array(dtype=wp.vec3),
    half: wp.array(dtype=wp.vec3),
    slot: wp.array(dtype=int),
    node: wp.array(dtype=int),
    out: wp.array(dtype=int),
):
    """Bit 0: the triangle in a slot is dropped for a box; bit 1: the node is."""
    i = wp.tid()
    cell = VoxelBox()
    cell.centre = centre[i]
    cell.half = half[i]
    cell.half2 = wp.dot(half[i], half[i])
    radius = wp.sqrt(cell.half2)
    ball = load4(balls, slot[i])
    dropped = 0
    if cone_misses(cell, radius, wp.vec3(ball[0], ball[1], ball[2]), ball[3], load4(cones.triangles, slot[i])):
        dropped = 1
    low, high = node_box(tree, node[i])
    if cone_misses(cell, radius, 0.5 * (low + high), 0.5 * wp.length(high - low), load4(cones.nodes, node[i])):
        dropped = dropped + 2
    out[i] = dropped


@wp.kernel
def _merge(a: wp.array(dtype=wp.vec4), b: wp.array(dtype=wp.vec4), out: wp.array(dtype=wp.vec4)):
    i = wp.tid()
    out[i] = merged(a[i], b[i])


@dataclass
class Built:
    """A mesh's hierarchy, and its cones as NumPy sees them."""

    vertices: np.ndarray
    faces: np.ndarray
    tree: Any
    features: Any
    cones: Any
    kept: list[torch.Tensor]

    @property
    def scale(self) -> float:
        return float(self.tree.frame.numpy()[0])

    @property
    def triangles(self) -> np.ndarray:
        return self.cones.triangles.numpy().reshape(-1, 4).astype(np.float64)

    @property
    def nodes(self) -> np.ndarray:
        # Large nodes have none: what stands there is whatever the memory held.
        with np.errstate(invalid="ignore"):
            return self.cones.nodes.numpy().reshape(-1, 4).astype(np.float64)

    @property
    def lowest(self) -> int:
        """The first node that has a cone."""
        return 1 << max(self.tree.depth - int(LEVELS), 0)

    def leaf_of(self, slots: np.ndarray) -> np.ndarray:
        leaves = 1 << self.tree.depth
        first = (np.arange(leaves + 1, dtype=np.int64) * self.tree.count) >> self.tree.depth
        return leaves + np.searchsorted(first, slots, side="right") - 1

    def misses(self, centre: np.ndarray, half: np.ndarray, slot: np.ndarray, node: np.ndarray) -> np.ndarray:
        out = wp.zeros(len(slot), dtype=int, device="cpu")
        boxes = [wp.array(v.astype(np.float32), dtype=wp.vec3, device="cpu") for v in (centre, half)]
        which = [wp.array(v.astype(np.int32), dtype=int, device="cpu") for v in (slot, node)]
        wp.launch(_misses, len(slot), [self.tree, self.features.balls, self.cones, *boxes, *which, out], device="cpu")
        return out.numpy()


def built(vertices: np.ndarray, faces: np.ndarray) -> Built:
    vertices, faces = np.asarray(vertices, np.float32), np.asarray(faces, np.int32)
    structure = build(torch.from_numpy(vertices)[None], torch.from_numpy(faces))
    tree, _winding, _frames, features, cones = structure.view
    return Built(vertices, faces, tree, features, cones, structure)


def sheet(count: int, z: Any, closed: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """A square of 2 count^2 triangles at heights z(x, y); if `closed`, its ends are joined with a half twist."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    x, y = 2 * i / count - 1, 2 * j / count - 1
    vertices = np.stack([x, y, z(x, y)], -1).reshape(-1, 3)
    number = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    if closed:
        turn, wide = np.pi * x, 0.3 * y
        radius = 0.7 + wide * np.cos(turn / 2)
        vertices = np.stack([radius * np.cos(turn), radius * np.sin(turn), wide * np.sin(turn / 2)], -1).reshape(-1, 3)
        number[-1] = number[0, ::-1]
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = [np.stack(corners, -1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    return vertices, np.concatenate(faces)


def spike(around: int, width: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed double cone with `around` faces at each of its two tips."""
    turn = 2 * np.pi * np.arange(around) / around
    rim = np.stack([width * np.cos(turn), width * np.sin(turn), 0 * turn], 1)
    after = (np.arange(around) + 1) % around
    up = np.stack([np.arange(around), after, np.full(around, around)], 1)
    down = np.stack([after, np.arange(around), np.full(around, around + 1)], 1)
    return np.concatenate([rim, [[0, 0, 0.9], [0, 0, -0.4]]]), np.concatenate([up, down])


def case(name: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = sphere(12)
    if name == "noisy sphere":
        vertices = vertices * rng.uniform(0.8, 1.0, (len(vertices), 1))
    if name == "very noisy sphere":
        vertices = vertices * rng.uniform(0.2, 1.0, (len(vertices), 1))
    if name == "flipped faces":
        flip = rng.random(len(faces)) < 0.3
        faces = np.where(flip[:, None], faces[:, ::-1], faces)
    if name == "no vertex twice":
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    if name == "needles":
        vertices = vertices * [1.0, 1e-2, 1e-4]
    if name == "three at an edge":
        # Another sphere on some of the first one's vertices.
        shift = np.where(rng.random(len(vertices)) < 0.5, np.arange(len(vertices)), len(vertices))
        other = np.where(shift < len(vertices), shift, np.arange(len(vertices)) + len(vertices))
        faces = np.concatenate([faces, other[faces]])
        vertices = np.concatenate([vertices, 0.7 * vertices])
    if name == "saddle":
        return sheet(12, lambda x, y: 0.6 * (x * x - y * y))
    if name == "folded sheet":
        return sheet(12, lambda x, y: 0.9 * (np.round(6 * (x + 1)) % 2) + 0.02 * rng.normal(size=x.shape))
    if name == "gently folded sheet":
        return sheet(12, lambda x, y: 0.05 * (np.round(6 * (x + 1)) % 2) + 0.01 * rng.normal(size=x.shape))
    if name == "Moebius strip":
        return sheet(16, lambda x, y: 0 * x, closed=True)
    if name == "spike":
        return spike(20, 0.05)
    if name == "flat tip":
        return spike(24, 0.98)
    if name == "too many at a tip":
        return spike(40, 0.98)
    if name == "soup on few vertices":
        return rng.uniform(-1, 1, (12, 3)), rng.integers(0, 12, (60, 3))
    return vertices, faces


CASES = [
    "sphere",
    "noisy sphere",
    "very noisy sphere",
    "flipped faces",
    "no vertex twice",
    "needles",
    "three at an edge",
    "saddle",
    "folded sheet",
    "gently folded sheet",
    "Moebius strip",
    "spike",
    "flat tip",
    "too many at a tip",
    "soup on few vertices",
]


def owner_of(faces: np.ndarray, corners: set[int]) -> int:
    """The first face that has all these corners."""
    has = np.stack([(faces == corner).any(1) for corner in corners]).all(0)
    return int(has.argmax())


def nearest_owners(mesh: Built, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors (N,3) from the nearest surface points, and the faces that own the features these lie on."""
    distance, closest, face = oracle.distance(mesh.vertices, mesh.faces, points)
    owners = np.empty(len(points), int)
    for i, (x, f) in enumerate(zip(closest, face, strict=True)):
        index = mesh.faces[f]
        corner = mesh.vertices[index].astype(np.float64)
        # Nearest to which corners and edges of its face, up to rounding in the brute force?
        at = [int(index[k]) for k in range(3) if np.linalg.norm(x - corner[k]) < 1e-13]
        on = []
        for k in range(3):
            a, b = corner[k], corner[(k + 1) % 3]
            e = b - a
            t = np.clip((x - a) @ e / max(e @ e, 1e-300), 0, 1)
            if np.linalg.norm(x - a - t * e) < 1e-13:
                on.append({int(index[k]), int(index[(k + 1) % 3])})
        owners[i] = owner_of(mesh.faces, {at[0]} if at else on[0] if on else set(index.tolist()))
        if not at and not on:
            owners[i] = f
    assert np.isfinite(distance).all()
    return points - closest, owners


def outside_by(cones: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Distance of unit vectors (N,3) from double cones (N,4), negative inside."""
    axis = cones[:, :3] / np.maximum(np.linalg.norm(cones[:, :3], axis=1, keepdims=True), 1e-30)
    along = np.abs((way * axis).sum(1))
    aside = np.linalg.norm(way - (way * axis).sum(1, keepdims=True) * axis, axis=1)
    sine = np.clip(cones[:, 3], -1, 1)
    return np.where(cones[:, 3] >= 1, -1.0, aside * np.sqrt(1 - sine * sine) - along * sine)


def places(rng: np.random.Generator, mesh: Built, count: int) -> np.ndarray:
    """Anywhere, and near the surface."""
    corner = mesh.vertices[mesh.faces[rng.integers(0, len(mesh.faces), count)]].astype(np.float64)
    near = (rng.dirichlet([0.5] * 3, count)[:, None] @ corner)[:, 0]
    points = near + rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-3, 0.5, (count, 1))
    points[::3] = rng.uniform(-1.3, 1.3, points[::3].shape)
    return points


@pytest.mark.parametrize("name", CASES)
def test_the_way_from_the_nearest_point_is_in_all_its_cones(name):
    rng = np.random.default_rng(11)
    mesh = built(*case(name, rng))
    points = places(rng, mesh, 600)
    way, owner = nearest_owners(mesh, points)
    off = np.linalg.norm(way, axis=1) > 1e-6
    points, owner = points[off], owner[off]
    unit = way[off] / np.linalg.norm(way[off], axis=1, keepdims=True)
    slot_of = np.argsort(mesh.tree.face.numpy())
    slot = slot_of[owner]
    assert outside_by(mesh.triangles[slot], unit).max() <= 0
    node = mesh.leaf_of(slot)
    up = 0
    while (node >= mesh.lowest).all() and node.min() > 0:
        cones = mesh.nodes[node]
        assert (cones[:, 3] >= 0).all()
        assert outside_by(cones, unit).max() <= 0, f"{up} levels above the leaves"
        # Nor is anything dropped for boxes of any size and shape that hold the point.
        for _ in range(4):
            half = 10.0 ** rng.uniform(-6, -0.3, (len(points), 1)) * rng.uniform(0, 1, (len(points), 3))
            half[rng.random(len(half)) < 0.1] = 0
            centre = (points - np.clip(2 * rng.normal(size=half.shape), -1, 1) * half) * mesh.scale
            # Rounding the centre must not leave the point outside.
            half = half * mesh.scale + 1e-7 * np.abs(centre)
            assert not mesh.misses(centre, half, slot, node).any()
        node = node // 2
        up += 1
    assert up == min(mesh.tree.depth, int(LEVELS)) + 1


def sines_of_faces(mesh: Built) -> np.ndarray:
    sines = np.empty(len(mesh.faces))
    sines[mesh.tree.face.numpy()] = mesh.triangles[:, 3]
    return sines


def test_every_direction_counts_where_the_surface_ends():
    mesh = built(*case("saddle", np.random.default_rng(0)))
    sines = sines_of_faces(mesh)
    vertices = mesh.vertices[mesh.faces]
    at_rim = ((np.abs(vertices[..., :2]) == 1).sum(1) >= 2).any(1)
    assert at_rim.sum() == 46
    assert (sines[at_rim] == 1).all()
    # Of those well inside none is so.
    assert (sines[(np.abs(vertices[..., :2]) < 0.9).all((1, 2))] < 0.5).all()
    assert (sines_of_faces(built(*case("no vertex twice", np.random.default_rng(0)))) == 1).all()


@pytest.mark.parametrize("around", [31, 32, 33, 40])
def test_every_direction_counts_where_too_many_faces_meet(around):
    """A nearly flat tip in a disc, whose outer faces come first and own all but the tip and its spokes."""
    vertices, faces = spike(around, 0.5)
    vertices[around] = [0, 0, 0.01]
    vertices = np.concatenate([vertices[: around + 1], 1.8 * vertices[:around]])
    inner, outer = faces[:around, :2], faces[:around, :2] + around + 1
    ring = [np.stack(corners, 1) for corners in ((inner[:, 1], inner[:, 0], outer[:, 0]), (inner[:, 1], *outer.T))]
    faces = np.concatenate([*(feature[:, ::-1] for feature in ring), faces[:around]])
    sines = sines_of_faces(built(vertices, faces))
    tip = owner_of(faces, {around})
    assert (sines[tip] == 1) == (around > MOST_AROUND)
    assert (sines[2 * around :] < 0.1).sum() == around - (around > MOST_AROUND)


def test_every_direction_counts_for_a_triangle_without_a_normal():
    vertices, faces = sphere(4)
    vertices = np.concatenate([vertices, [vertices[faces[0]].mean(0)]])
    flat = np.array([[faces[0, 0], faces[0, 0], faces[0, 1]], [faces[5, 0], faces[5, 0], faces[5, 0]]])
    assert (sines_of_faces(built(vertices, np.concatenate([faces, flat])))[-2:] == 1).all()


def random_cones(rng: np.random.Generator, count: int) -> np.ndarray:
    axis = rng.normal(size=(count, 3))
    axis[::3] = axis[0] + 10.0 ** rng.uniform(-9, 0, (len(axis[::3]), 1)) * axis[::3]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    axis[::5] *= -1
    sine = np.sin(rng.choice([0.0, 1e-4, 0.1, 0.7, 1.4, 1.55, np.pi / 2], count) * rng.uniform(0, 1, count))
    sine[rng.random(count) < 0.1] = 1
    return np.concatenate([axis, sine[:, None]], 1).astype(np.float32)


def test_a_merged_cone_holds_both():
    rng = np.random.default_rng(3)
    count = 20000
    a, b = random_cones(rng, count), random_cones(rng, count)
    out = wp.zeros(count, dtype=wp.vec4, device="cpu")
    wp.launch(_merge, count, [*(wp.array(v, dtype=wp.vec4, device="cpu") for v in (a, b)), out], device="cpu")
    both = out.numpy().astype(np.float64)
    # Each cone had this much more than it needed, of which merging may take a little.
    spare = 1e-6
    for cone in (a.astype(np.float64), b.astype(np.float64)):
        narrow = cone[:, 3] < 1
        assert (both[~narrow, 3] == 1).all()
        axis = cone[:, :3] / np.linalg.norm(cone[:, :3], axis=1, keepdims=True)
        for _ in range(8):
            across = np.cross(axis, rng.normal(size=axis.shape))
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            # On its rim.
            way = np.sqrt(1 - cone[:, 3:] ** 2) * axis + cone[:, 3:] * across
            way *= rng.choice([-1, 1], (count, 1))
            assert outside_by(both, way)[narrow].max() <= spare
    # The least one: no wider than the two and what is between them.
    between = np.arccos(np.clip(np.abs((a[:, :3] * b[:, :3]).sum(1)), 0, 1))
    widest = np.arcsin(np.minimum(a[:, 3], 1)) + np.arcsin(np.minimum(b[:, 3], 1)) + between
    some = widest < 1
    assert some.any()
    assert (np.arcsin(both[some, 3]) <= widest[some] + 1e-3).all()


def test_nothing_and_a_cone_is_that_cone():
    cone, nothing = np.array([[0.6, 0, 0.8, 0.3]], np.float32), np.array([[0, 0, 0, -1]], np.float32)
    for a, b in ((cone, nothing), (nothing, cone)):
        out = wp.zeros(1, dtype=wp.vec4, device="cpu")
        wp.launch(_merge, 1, [*(wp.array(v, dtype=wp.vec4, device="cpu") for v in (a, b)), out], device="cpu")
        np.testing.assert_array_equal(out.numpy(), cone)


def test_most_of_a_smooth_surface_is_missed_from_afar():
    mesh = built(*sphere(32))
    assert np.median(mesh.triangles[:, 3]) < 0.2
    leaves = 1 << mesh.tree.depth
    slots = np.arange(mesh.tree.count)
    centre = np.tile([0.4, 1.6, -0.9], (len(slots), 1)) * mesh.scale
    half = np.full((len(slots), 3), 0.05 * mesh.scale)
    dropped = mesh.misses(centre, half, slots, mesh.leaf_of(slots))
    assert (dropped & 1 > 0).mean() > 0.8
    assert (dropped & 2 > 0).mean() > 0.7
    # What is dropped is neither before nor behind the point nearest to the box: all else is.
    normals = mesh.tree.corners.numpy().reshape(-1, 4, 3)[:, 3]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    facing = np.abs(normals @ centre[0]) / np.linalg.norm(centre[0])
    assert facing[dropped & 1 > 0].max() < 0.999
    # The highest nodes with cones are small enough for some of them to be missed too.
    top = np.arange(mesh.lowest, 2 * mesh.lowest)
    dropped = mesh.misses(centre[: len(top)], half[: len(top)], 0 * top, top)
    assert leaves > len(top) > 8
    assert (dropped & 2 > 0).any()
