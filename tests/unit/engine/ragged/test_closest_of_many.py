"""Closest points of slabs, of batches that share their faces, and of lists: those of single maps."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube, sphere

BALL = sdm.TriangleMesh(*sphere(12))
SHEET = sdm.TriangleMesh(BALL.vertices, BALL.faces[: len(BALL) // 2])


def assert_same(hit: sdm.Closest, other: sdm.Closest) -> None:
    assert torch.equal(hit.points, other.points)
    assert torch.equal(hit.faces, other.faces)
    assert torch.equal(hit.barycentric, other.barycentric)
    assert torch.equal(hit.directions, other.directions)


@pytest.mark.parametrize("sign", ["winding", "none", "flood"])
def test_slabs_make_the_whole_map(sign):
    index = sdm.MeshIndex(SHEET, "cpu", warn=False)
    grid = sdm.Grid.around(SHEET, (70, 7, 9))
    field, whole = index.signed_distance_map(grid, sign=sign, return_closest=True)
    slabs = list(index.slabs(grid, 1, sign=sign, return_closest=True))
    assert [(begin, end) for begin, end, *_ in slabs] == [(0, 32), (32, 64), (64, 70)]
    assert torch.equal(torch.cat([values for _, _, values, _ in slabs]), field.values)
    for begin, end, _, hit in slabs:
        of_slab = whole.points[begin:end], whole.faces[begin:end], whole.barycentric[begin:end]
        assert all(torch.equal(*pair) for pair in zip((hit.points, hit.faces, hit.barycentric), of_slab, strict=True))
        assert torch.equal(hit.directions, whole.directions[begin:end])
        assert torch.equal(hit.interpolate(SHEET.vertices), whole.interpolate(SHEET.vertices)[begin:end])


def test_slabs_count_what_is_ambiguous_and_pass_gradients_on():
    grid = sdm.Grid.around(SHEET, (40, 7, 9))
    unclear = torch.zeros((), dtype=torch.int64)
    vertices = SHEET.vertices.clone().requires_grad_()
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, SHEET.faces), "cpu", warn=False)
    slabs = list(index.slabs(grid, 1, ambiguous=unclear, return_closest=True))
    assert int(unclear) == index.signed_distance_map(grid).ambiguous_voxels > 0
    assert not slabs[0][3].points.requires_grad
    slabs[0][2].sum().backward()
    assert vertices.grad is not None


def test_slabs_of_a_mesh_with_many_copies_of_a_triangle():
    mesh = sdm.TriangleMesh(BALL.vertices, torch.cat([BALL.faces[:1].repeat(100, 1), BALL.faces[1:]]))
    index = sdm.MeshIndex(mesh, "cpu", warn=False)
    assert index._repeated is not None
    grid = sdm.Grid.around(mesh, (33, 6, 6))
    field, whole = index.signed_distance_map(grid, return_closest=True)
    (_, _, values, hit), (_, _, last, _) = index.slabs(grid, 1, return_closest=True)
    assert torch.equal(torch.cat([values, last]), field.values)
    assert torch.equal(hit.faces, whole.faces[:32])


@pytest.mark.parametrize("sign", ["winding", "none", "flood"])
def test_batches_give_what_single_maps_give(sign):
    batch = torch.stack([BALL.vertices, 0.7 * BALL.vertices, BALL.vertices * torch.tensor([1.0, 0.5, 0.8])])
    grid = sdm.Grid.around(BALL, 11)
    maps, hit = sdm.signed_distance_maps(batch, SHEET.faces, grid, sign=sign, return_closest=True, device="cpu")
    assert hit.points.shape == (3, *grid.shape, 3)
    places, numbers = hit.interpolate(batch), hit.of_faces(torch.arange(len(SHEET)).expand(3, -1))
    for i, vertices in enumerate(batch):
        index = sdm.MeshIndex(sdm.TriangleMesh(vertices, SHEET.faces), "cpu", warn=False)
        field, own = index.signed_distance_map(grid, sign=sign, return_closest=True)
        assert torch.equal(maps[i], field.values)
        assert_same(sdm.Closest(hit.points[i], hit.faces[i], hit.barycentric[i], _asked=grid), own)
        assert torch.equal(places[i], own.interpolate(vertices))
        assert torch.equal(numbers[i], own.faces.long())
    # Values that all meshes have in common.
    heights = hit.interpolate(BALL.vertices[:, 2])
    assert heights.shape == (3, *grid.shape)
    assert torch.equal(heights[0], hit.interpolate(torch.stack([BALL.vertices[:, 2]] * 3))[0])
    with pytest.raises(sdm.MeshError, match=r"\(3, \d+, ...\) is needed"):
        hit.interpolate(torch.zeros(2, BALL.vertices.shape[0]))


def test_gradients_of_batches_are_as_without():
    grads = []
    for options in ({}, {"return_closest": True}):
        batch = torch.stack([BALL.vertices] * 2).requires_grad_()
        found = sdm.signed_distance_maps(batch, BALL.faces, sdm.Grid.around(BALL, 7), device="cpu", **options)
        (found[0] if options else found).square().sum().backward()
        grads.append(batch.grad)
    assert torch.equal(*grads)


def test_what_a_batch_does_not_take():
    grid = sdm.Grid.around(BALL, 7)
    for options, message in (
        ({"orient": "auto"}, "orient='auto' is for single meshes and lists"),
        ({"compare_signs": True}, "compare_signs=True is for single meshes and lists"),
        ({"sign": "sideways"}, "sign is 'sideways'"),
        ({"orient": "sideways"}, "orient is 'sideways'"),
        ({"hole_size": 1.0}, "hole_size is the width of gaps for sign='flood'"),
    ):
        with pytest.raises(sdm.SDMError, match=message):
            sdm.signed_distance_maps(BALL.vertices[None], BALL.faces, grid, device="cpu", **options)


def test_bad_options_of_a_list_are_refused_before_any_mesh_is_taken():
    def meshes():
        raise AssertionError("a mesh was asked for")
        yield BALL

    for options in ({"sign": "sideways"}, {"orient": "sideways"}, {"hole_size": -1.0, "sign": "flood"}):
        with pytest.raises(sdm.SDMError):
            sdm.signed_distance_maps(meshes(), 7, device="cpu", **options)
    with pytest.raises(sdm.SDMError, match="a flood needs the voxels of a grid"):
        sdm.signed_distances(meshes(), iter([]), sign="flood")


def test_every_kind_of_iterable():
    meshes = {"ball": BALL, "cube": sdm.TriangleMesh(*cube()), "again": BALL}
    grids = [sdm.Grid.around(mesh, 6 + i) for i, mesh in enumerate(meshes.values())]
    expected = [
        sdm.signed_distance_map(mesh, grid, device="cpu") for mesh, grid in zip(meshes.values(), grids, strict=True)
    ]

    class Folder:
        def __iter__(self):
            return iter(meshes.values())

    for given, where in (
        (meshes.values(), grids),
        (tuple(meshes.values()), iter(grids)),
        (Folder(), tuple(grids)),
    ):
        found = sdm.signed_distance_maps(given, where, device="cpu")
        assert isinstance(found, list)
        assert all(torch.equal(one.values, two.values) for one, two in zip(found, expected, strict=True))
    lazily = sdm.signed_distance_maps((mesh for mesh in meshes.values()), grids, device="cpu", return_closest=True)
    field, hit = next(lazily)
    assert torch.equal(field.values, expected[0].values)
    assert torch.equal(hit.interpolate(BALL.vertices), hit.interpolate(BALL.vertices))
    points = torch.zeros(3, 2, 3)
    assert len(sdm.signed_distances(Folder(), points, device="cpu")) == 3
    assert len(sdm.signed_distances(meshes.values(), points, device="cpu")) == 3


def test_a_mesh_that_a_flood_cannot_hold_is_named():
    far = sdm.Grid((0, 0, 0), (1e-4, 1e-4, 1e-4), (4, 4, 4))
    with pytest.raises(sdm.GridError, match=r"^mesh 1: a flood comes from outside"):
        sdm.signed_distance_maps([BALL, BALL], [sdm.Grid.around(BALL, 6), far], device="cpu", sign="flood")
