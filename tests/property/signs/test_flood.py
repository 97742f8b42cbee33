"""Signs by a flood: the oracle's, those of winding numbers for closed meshes, and sensible ones for others."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.engine.flood import frame_of
from sdm.errors import GridError, SDMError
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.cap_triangles import small_caps
from tests.helpers import flood_oracle
from tests.helpers.oracle import distance


def ball(level: int = 3) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(level)


def without(mesh: trimesh.Trimesh, gone: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)[~gone]


def l_shape() -> tuple[np.ndarray, np.ndarray]:
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2.0]])
    low, high = (np.column_stack([outline, np.full(6, z)]) for z in (0.0, 1.0))
    flat = np.array([[0, 1, 3], [1, 2, 3], [0, 3, 4], [0, 4, 5]])
    sides = [t for i in range(6) for j in [(i + 1) % 6] for t in ([i, j, 6 + j], [i, 6 + j, 6 + i])]
    return np.concatenate([low, high]), np.concatenate([flat[:, ::-1], flat + 6, sides])


def overlapping() -> tuple[np.ndarray, np.ndarray]:
    one, other = ball(2), trimesh.creation.box()
    return np.concatenate([one.vertices, other.vertices + 0.6]), np.concatenate([one.faces, other.faces + 162])


CLOSED = {
    "ball": (ball().vertices, ball().faces),
    "torus": (trimesh.creation.torus(1, 0.4).vertices, trimesh.creation.torus(1, 0.4).faces),
    "box": (trimesh.creation.box().vertices, trimesh.creation.box().faces),
    "ring": (trimesh.creation.annulus(0.3, 1, 0.5).vertices, trimesh.creation.annulus(0.3, 1, 0.5).faces),
    "L": l_shape(),
    "overlapping": overlapping(),
}


@pytest.mark.parametrize("name", CLOSED)
@pytest.mark.parametrize(("resolution", "margin"), [(9, 0.05), (17, 0.0), (33, 0.1)])
def test_closed_meshes_have_the_map_of_winding_numbers(name, resolution, margin, device):
    mesh = sdm.TriangleMesh(*CLOSED[name])
    index = sdm.MeshIndex(mesh, device)
    grid = sdm.Grid.around(mesh, resolution, margin=margin)
    expected, found = index.signed_distance_map(grid), index.signed_distance_map(grid, sign="flood")
    assert torch.equal(found.values.view(torch.int32), expected.values.view(torch.int32))
    assert (expected.sign, found.sign, found.hole_size) == ("winding", "flood", 2 * grid.spacing[0])
    assert found.inside_voxels > 0


def test_turned_grids_of_unequal_spacing_and_meshes_beyond_the_grid(device):
    index = sdm.MeshIndex(CLOSED["ball"], device)
    c, s = np.cos(0.5), np.sin(0.5)
    turned = sdm.Grid((-1.5, -1.2, -1.5), (0.1, 0.07, 0.12), (28, 40, 26), [[c, -s, 0], [s, c, 0], [0, 0, 1]])
    within = sdm.Grid((-0.5, -0.5, -0.5), (0.05,) * 3, (30, 20, 64))
    for grid in (turned, within):
        expected = index.signed_distance_map(grid)
        assert torch.equal(index.signed_distance_map(grid, sign="flood").values, expected.values)
        assert 0 < expected.inside_voxels < grid.size


def test_a_grid_that_cannot_hold_the_mesh_is_refused():
    grid = sdm.Grid((0, 0, 0), (1e-3,) * 3, (8, 8, 8))
    with pytest.raises(GridError, match="has to hold the mesh"):
        sdm.signed_distance_map(CLOSED["ball"], grid, sign="flood")


DIRTY = {
    "ball": (CLOSED["ball"], 0.6),
    "bowl": (without(ball(2), ball(2).triangles_center[:, 2] > 0), 1.0),
    "wide bowl": (without(ball(2), ball(2).triangles_center[:, 2] > 0), 2.2),
    "hole": (without(ball(2), ball(2).triangles_center[:, 2] > 0.8), 0.7),
    "L": (l_shape(), 0.3),
    "soup": ((np.random.default_rng(0).random((60, 3)), np.arange(60).reshape(-1, 3)), 0.2),
    "holes": (without(ball(2), np.random.default_rng(1).random(320) < 0.2), 0.4),
}


@pytest.mark.parametrize("name", DIRTY)
def test_flood_is_the_oracles(name, device):
    (vertices, faces), hole = DIRTY[name]
    mesh = sdm.TriangleMesh(vertices, faces)
    grid = sdm.Grid.around(mesh, (15, 14, 13), margin=0.12)
    index = sdm.MeshIndex(mesh, device, warn=False)
    found = index.signed_distance_map(grid, sign="flood", hole_size=hole).values.cpu().numpy()
    near = distances = index.signed_distance_map(grid, sign="none").values.cpu().numpy()
    assert np.array_equal(np.abs(found), distances)
    caps = small_caps(boundary_edges(mesh.vertices, mesh.faces), mesh.vertices, hole)
    walls = mesh.faces.numpy()
    if len(caps):
        closing = sdm.signed_distance_map((mesh.vertices, caps), grid, sign="none", device=device)
        near = np.minimum(distances, closing.numpy())
        walls = np.concatenate([walls, caps.numpy()])
    frame = frame_of(grid, mesh.vertices, mesh.faces)
    assert frame.grid is grid
    index_of = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), -1)
    expected = flood_oracle.inside(
        distances,
        near,
        grid.spacing,
        np.asarray(((index_of < frame.low) | (index_of > frame.high)).any(-1)),
        hole / 2,
        float(frame.as_struct(hole / 2).slack),
        grid.points().numpy(),
        lambda p: distance(mesh.vertices.numpy(), walls, p[None])[1][0],
    )
    off = distances > 1e-5
    assert np.array_equal((found < 0)[off], expected[off])


def count(mesh: tuple[np.ndarray, np.ndarray], hole: float | None, resolution: int = 24) -> int:
    index = sdm.MeshIndex(mesh, "cpu", warn=False)
    return index.signed_distance_map(resolution, sign="flood", hole_size=hole).inside_voxels


def test_a_bowl_is_filled_where_its_opening_is_narrower():
    bowl = without(ball(), ball().triangles_center[:, 2] > 0)
    assert [count(bowl, hole) for hole in (0.3, 1.0, 1.98)] == [0, 0, 0]
    voxel = float(sdm.Grid.around(bowl, 24).spacing[0])
    assert count(bowl, 2.02) == pytest.approx(2 / 3 * np.pi / voxel**3, rel=0.1)


def test_a_missing_triangle_is_closed_and_a_wide_hole_is_not():
    whole = sdm.signed_distance_map((ball().vertices, ball().faces), 24).inside_voxels
    assert count(without(ball(), np.arange(1280) == 5), None) == pytest.approx(whole, abs=2)
    wide = without(ball(), ball().triangles_center[:, 2] > 0.5)
    assert count(wide, None) == 0
    assert count(wide, 2.0) > 0.6 * whole


def test_sheets_have_no_inside():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    assert [count(square, hole, 17) for hole in (None, 0.0, 0.5, 3.0)] == [0] * 4


def test_a_ball_without_a_third_of_its_faces_is_filled_once_holes_are_bridged():
    gone = np.random.default_rng(2).random(1280) < 0.3
    whole = sdm.signed_distance_map((ball().vertices, ball().faces), 24).inside_voxels
    assert count(without(ball(), gone), 0.05) == 0
    for hole in (0.3, 0.5, 1.5):
        assert count(without(ball(), gone), hole) == pytest.approx(whole, rel=0.01)


def test_faces_may_face_any_way(device):
    vertices, faces = CLOSED["torus"]
    turn = np.random.default_rng(0).random(len(faces)) < 0.5
    mixed = np.where(turn[:, None], np.asarray(faces)[:, ::-1], faces)
    grid = sdm.Grid.around((vertices, faces), 24)
    expected = sdm.signed_distance_map((vertices, faces), grid, device=device)
    found = sdm.MeshIndex((vertices, mixed), device, warn=False).signed_distance_map(grid, sign="flood")
    assert torch.equal(found.values < 0, expected.values < 0)
    assert torch.allclose(found.values, expected.values, rtol=0, atol=1e-6)


def test_a_cavity_is_inside_for_the_flood_alone():
    outer, inner = ball(2), ball(2)
    vertices = np.concatenate([outer.vertices, 0.5 * inner.vertices])
    shell = vertices, np.concatenate([outer.faces, inner.faces[:, ::-1] + 162])
    field = sdm.signed_distance_map(shell, 24, compare_signs=True)
    alone = sdm.signed_distance_map((0.5 * inner.vertices, inner.faces), field.grid)
    assert field.sign_disagreements == alone.inside_voxels > 0
    assert field.sign == "winding"


def test_signs_are_compared_only_if_asked_for():
    mesh = CLOSED["ball"]
    for sign in ("winding", "flood", "none"):
        plain = sdm.signed_distance_map(mesh, 12, sign=sign)
        compared = sdm.signed_distance_map(mesh, 12, sign=sign, compare_signs=True)
        assert (plain.sign_disagreements, compared.sign_disagreements) == (None, 0)
        assert plain.sign == compared.sign == sign
        assert torch.equal(plain.values, compared.values)


def test_unsigned_maps(device):
    mesh = CLOSED["torus"]
    expected = sdm.signed_distance_map(mesh, 24, device=device)
    for _ in range(4):  # on a GPU the last ones are replayed
        found = sdm.signed_distance_map(mesh, 24, device=device, sign="none")
        assert torch.equal(found.values, expected.values.abs())
    index = sdm.MeshIndex(mesh, device)
    assert torch.equal(index.signed_distance_map(24, sign="none").values, found.values)
    assert found.inside_voxels == 0
    assert found.ambiguous_voxels is None
    assert "unsigned" in repr(found)


def test_thick_slices_without_a_sign():
    mesh = CLOSED["torus"]
    grid = sdm.Grid((-1.5, -1.5, -0.6), (0.05, 0.05, 0.4), (60, 60, 4))
    expected = sdm.signed_distance_map(mesh, grid)
    assert torch.equal(sdm.signed_distance_map(mesh, grid, sign="none").values, expected.values.abs())
    assert torch.equal(sdm.signed_distance_map(mesh, grid, sign="flood").values, expected.values)


def test_slabs_are_the_map(device):
    index = sdm.MeshIndex(CLOSED["torus"], device)
    grid = sdm.Grid.around(CLOSED["torus"], 70)
    for sign in ("flood", "none"):
        slabs = [values for _, _, values in index.slabs(grid, max_bytes=1, sign=sign)]
        assert len(slabs) == 3
        assert torch.equal(torch.cat(slabs), index.signed_distance_map(grid, sign=sign).values)


@pytest.mark.parametrize("sign", ["flood", "none"])
def test_gradients_have_the_maps_sign(sign):
    vertices = torch.tensor(CLOSED["box"][0], dtype=torch.float32, requires_grad=True)
    mesh = sdm.TriangleMesh(vertices, CLOSED["box"][1])
    (found,) = torch.autograd.grad(sdm.signed_distance_map(mesh, 8, sign=sign).values.sum(), vertices)
    values = sdm.signed_distance_map(mesh, 8).values
    (expected,) = torch.autograd.grad((values if sign == "flood" else values.abs()).sum(), vertices)
    assert torch.allclose(found, expected)
    assert found.abs().sum() > 0


def test_wrong_signs_are_refused_in_one_sentence():
    mesh = CLOSED["box"]
    with pytest.raises(SDMError, match="use 'winding', 'flood' or 'none'"):
        sdm.signed_distance_map(mesh, 8, sign="parity")  # pyright: ignore[reportArgumentType]
    with pytest.raises(SDMError, match="give a length of at least 0"):
        sdm.signed_distance_map(mesh, 8, sign="flood", hole_size=-1)
    with pytest.raises(SDMError, match="it says nothing"):
        sdm.signed_distance_map(mesh, 8, hole_size=0.1)


def test_closest_points_come_with_every_sign(device):
    index = sdm.MeshIndex(CLOSED["torus"], device)
    for sign in ("winding", "flood", "none"):
        field, hit = index.signed_distance_map(16, sign=sign, return_closest=True)
        assert torch.equal(field.values, index.signed_distance_map(16, sign=sign).values)
        assert (field.sign, field.sign_disagreements) == (sign, None)
        assert tuple(hit.points.shape) == (16, 16, 16, 3)


def test_points_have_distances_without_a_sign_and_no_flood(device):
    bowl = without(ball(2), ball(2).triangles_center[:, 2] > 0)
    points = torch.rand(300, 3, generator=torch.Generator().manual_seed(0)).to(device) * 3 - 1.5
    index = sdm.MeshIndex(bowl, device)
    expected, hit = index.signed_distance(points, return_closest=True)
    for measure in (index.signed_distance, lambda *at, **how: sdm.signed_distance(bowl, *at, device=device, **how)):
        assert torch.equal(measure(points, sign="none"), expected.abs())
        values, there = measure(points, sign="none", return_closest=True)
        assert torch.equal(values, expected.abs())
        assert torch.equal(there.faces, hit.faces)
        with pytest.raises(SDMError, match="for maps, not for points"):
            measure(points, sign="flood")


def test_a_list_without_room_changes_nothing(device, monkeypatch):
    index = sdm.MeshIndex(DIRTY["holes"][0], device, warn=False)
    expected = index.signed_distance_map(20, sign="flood", hole_size=0.4).values
    monkeypatch.setattr("sdm.engine.flood.LISTED", 1 << 20)
    assert torch.equal(index.signed_distance_map(20, sign="flood", hole_size=0.4).values, expected)
