"""Lists of meshes: what is taken, in which order, and what is refused with which sentence."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube, sphere
from sdm.engine.ragged import calls, joint_maps

MESHES = [sdm.TriangleMesh(*cube()), sdm.TriangleMesh(*sphere(8)), sdm.TriangleMesh(*sphere(12))]
GRID = sdm.Grid.around(MESHES[0], 9)


def counted(taken: list[int], items: list) -> Iterator:
    for i, item in enumerate(items):
        taken.append(i)
        yield item


def test_no_meshes():
    assert sdm.signed_distance_maps([], GRID, device="cpu") == []
    assert sdm.signed_distance_maps([], [], device="cpu") == []
    assert sdm.signed_distances([], [], device="cpu") == []
    assert list(sdm.signed_distance_maps(iter([]), GRID, device="cpu")) == []


def test_meshes_are_made_together(monkeypatch):
    together = []

    def made(jobs, *, signed):
        together.append(len(jobs))
        return joint_maps.ragged_maps(jobs, signed=signed)

    monkeypatch.setattr(calls, "ragged_maps", made)
    assert len(sdm.signed_distance_maps(MESHES, GRID, device="cpu")) == 3
    assert together == [3]


@pytest.mark.filterwarnings("ignore::sdm.SDMWarning")
def test_open_meshes_are_made_one_by_one_where_calls_are_recorded(monkeypatch):
    together = []

    def made(jobs, *, signed):
        together.append([job.number for job in jobs])
        return joint_maps.ragged_maps(jobs, signed=signed)

    monkeypatch.setattr(calls, "ragged_maps", made)
    vertices, faces = sphere(12)
    meshes = [*MESHES, sdm.TriangleMesh(vertices, faces[:-7]), sdm.TriangleMesh(vertices, faces[9:])]
    expected = sdm.signed_distance_maps(meshes, GRID, device="cpu")
    monkeypatch.setattr(calls, "RECORDING_DEVICES", ("cpu",))
    found = sdm.signed_distance_maps(meshes, GRID, device="cpu")
    assert together == [[0, 1, 2, 3, 4], [0, 1, 2]]
    for one, other in zip(found, expected, strict=True):
        assert torch.equal(one.values, other.values)
        assert one.ambiguous_voxels == other.ambiguous_voxels
    # Where nobody asks for the side of a hole, all are made together.
    sdm.signed_distance_maps(meshes, GRID, device="cpu", sign="none")
    assert together[-1] == [0, 1, 2, 3, 4]


def test_an_iterator_is_taken_as_it_is_needed():
    taken: list[int] = []
    found = sdm.signed_distance_maps(counted(taken, MESHES * 4), 7, device="cpu", max_bytes=1)
    assert taken == []
    first = next(found)
    # A chunk has one mesh, and the next one tells that it is full.
    assert len(taken) == 2
    assert torch.equal(first.values, sdm.signed_distance_map(MESHES[0], 7, device="cpu").values)
    assert [field.grid for field in found] == [sdm.Grid.around(mesh, 7) for mesh in (MESHES * 4)[1:]]


def test_iterators_of_grids_and_points():
    found = list(sdm.signed_distance_maps(iter(MESHES), iter([GRID] * 3), device="cpu"))
    assert [field.grid for field in found] == [GRID] * 3
    points = torch.rand(3, 5, 3)
    values = list(sdm.signed_distances(iter(MESHES), points, device="cpu"))
    assert all(
        torch.equal(v, sdm.signed_distance(m, p, device="cpu")) for v, m, p in zip(values, MESHES, points, strict=True)
    )


def test_gradients_flow_through_meshes_that_need_them():
    vertices = MESHES[1].vertices.clone().requires_grad_()
    moving = sdm.TriangleMesh(vertices, MESHES[1].faces)
    found = sdm.signed_distance_maps([MESHES[0], moving, MESHES[2]], GRID, device="cpu")
    found[1].values.sum().backward()
    alone = MESHES[1].vertices.clone().requires_grad_()
    sdm.signed_distance_map(sdm.TriangleMesh(alone, MESHES[1].faces), GRID, device="cpu").values.sum().backward()
    assert torch.equal(vertices.grad, alone.grad)
    assert not found[0].values.requires_grad


def test_one_mesh_with_many_copies_of_a_triangle():
    copies = sdm.TriangleMesh(*(lambda v, f: (v, np.concatenate([f, np.repeat(f[:1], 500, 0)])))(*cube()))
    found = sdm.signed_distance_maps([MESHES[0], copies, MESHES[1]], GRID, device="cpu")
    for field, mesh in zip(found, [MESHES[0], copies, MESHES[1]], strict=True):
        assert torch.equal(field.values, sdm.signed_distance_map(mesh, GRID, device="cpu").values)


def test_a_bad_mesh_is_named_by_its_number():
    wrong = sdm.TriangleMesh(MESHES[1].vertices, MESHES[1].faces + 3, check=False)
    for bad, message in (
        (object(), "^mesh 2: an object of type object is no mesh"),
        ((np.full((3, 3), np.nan), [[0, 1, 2]]), "^mesh 2: vertex 0 of"),
        (wrong, r"^mesh 2: a face uses vertex \d+, but the \d+ vertices are numbered 0 to \d+$"),
    ):
        with pytest.raises(sdm.MeshError, match=message):
            sdm.signed_distance_maps([*MESHES[:2], bad, MESHES[2]], GRID, device="cpu")
        with pytest.raises(sdm.MeshError, match=message):
            sdm.signed_distances([*MESHES[:2], bad], [torch.zeros(1, 3)] * 3, device="cpu")


def test_as_many_grids_and_points_as_meshes():
    with pytest.raises(sdm.GridError, match="3 meshes and 2 grids were given"):
        sdm.signed_distance_maps(MESHES, [GRID] * 2, device="cpu")
    for odd in ([8], [8, 9]):
        with pytest.raises(sdm.GridError, match=r"the numbers \[8.*\] are no grid: give one, or three"):
            sdm.signed_distance_maps(MESHES[:2], odd, device="cpu")
    with pytest.raises(sdm.MeshError, match="grids ended before mesh 2"):
        list(sdm.signed_distance_maps(iter(MESHES), [GRID] * 2, device="cpu"))
    with pytest.raises(sdm.MeshError, match="3 meshes came, and more grids"):
        list(sdm.signed_distance_maps(iter(MESHES), [GRID] * 4, device="cpu"))
    with pytest.raises(sdm.MeshError, match="3 meshes and 2 sets of points were given"):
        sdm.signed_distances(MESHES, torch.zeros(2, 5, 3), device="cpu")
    with pytest.raises(sdm.MeshError, match=r"the points have shape \(2,\)"):
        sdm.signed_distances(MESHES[:1], [[0.0, 1.0]], device="cpu")
    with pytest.raises(sdm.GridError, match="mesh 1: the grid's resolution"):
        list(sdm.signed_distance_maps(iter(MESHES), iter([9, -1, 9]), device="cpu"))


def test_files_are_read_as_they_are_needed(tmp_path):
    for number, mesh in enumerate(MESHES):
        mesh.save(tmp_path / f"{number}.ply")
    paths = [tmp_path / f"{number}.ply" for number in range(3)]
    found = sdm.signed_distance_maps(paths, 7, device="cpu")
    assert all(
        torch.equal(f.values, sdm.signed_distance_map(p, 7, device="cpu").values)
        for f, p in zip(found, paths, strict=True)
    )
    with pytest.raises(sdm.SDMError, match=r"^mesh 1: "):
        sdm.signed_distance_maps([paths[0], tmp_path / "none.ply"], 7, device="cpu")
