"""Bands that are queued with room, as a GPU records them: the bits of those made step by step, or nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere, torus
from sdm.engine.band import near_blocks, repeated_bands
from sdm.engine.band.band_slabs import measured_blocks
from sdm.engine.band.calls import band_width
from sdm.engine.band.listed_blocks import Room
from sdm.engine.plan_override import plan_override
from sdm.kernels.band.block_bits import COUNTS, LOST
from sdm.kernels.band.query import MOST_CHUNKS, band_plan
from sdm.kernels.bvh.tree import depth_for
from sdm.kernels.dense.plan import Workload, make_plan
from sdm.kernels.plan_options import PlanOptions
from sdm.kernels.topology.edge_pairing import FLAGS
from sdm.runtime import graphs

AMPLE = Room(6000, 3000)


def queued(mesh: sdm.TriangleMesh, grid: sdm.Grid, half_width: float = 3.0, room: Room = AMPLE):
    """Blocks, values and runs; None where a guess was wrong."""
    width = band_width(grid, half_width)
    with plan_override(method="cells", slice_factors=(1,)):
        call = repeated_bands.band_call(mesh, grid, width, room)
        made = call.work(lambda flags: None, *call.inputs)
    assert call.finish is not None
    return made, call.finish(made)


def assert_same(found: tuple, band: sdm.SparseSDM) -> None:
    for one, other in zip(found, (band.blocks, band.values, band.inside), strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize(
    ("cell", "half_width", "devices"),
    [(8, 1.5, ("cuda",)), (8, 4.2, ("cuda", "cpu")), (16, 4.2, ("cuda",)), (16, 1.5, ("cuda", "cpu"))],
)
def test_the_bits_of_a_band_made_step_by_step(cell, half_width, devices, monkeypatch):
    """Also where blocks are marked by triangles, before the tree has boxes."""
    monkeypatch.setattr(near_blocks, "BY_TRIANGLES", devices)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    turn[:, 2] *= np.linalg.det(turn)
    for arrays in (torus(3000), sphere(9)):
        mesh = sdm.TriangleMesh(*arrays)
        turned = sdm.Grid(-turn @ np.array([1.9, 1.8, 1.9]), (0.055, 0.045, 0.06), (70, 81, 66), turn)
        for grid in (sdm.Grid.around(mesh, 75), turned):
            with plan_override(method="cells", cell=cell, slice_factors=(1,)):
                band = sdm.narrow_band(mesh, grid, half_width=half_width, device="cpu")
                made, found = queued(mesh, grid, half_width)
            assert found is not None
            assert_same(found, band)
            assert made[0][FLAGS:][:COUNTS][LOST] == 0


def test_what_was_guessed_wrong_is_not_taken():
    mesh = sdm.TriangleMesh(*sphere(9))
    grid = sdm.Grid.around(mesh, 75)
    needed = sdm.narrow_band(mesh, grid, device="cpu")
    blocks, regions = len(needed), len(torch.unique(needed.blocks // 2, dim=0))
    assert queued(mesh, grid)[1] is not None
    assert queued(mesh, grid, room=Room(blocks // 2, 3000))[1] is None
    assert queued(mesh, grid, room=Room(6000, regions // 9))[1] is None
    # With fewer chunks of candidate lists than regions need, voxels are searched one by one: right, but slow.
    assert queued(mesh, grid, room=Room(6000, 3000, 100))[1] is None
    opened = sdm.TriangleMesh(mesh.vertices, mesh.faces[3:])
    assert queued(opened, grid)[1] is None
    beyond = sdm.Grid(grid.origin, grid.spacing, (40, 75, 75))
    assert queued(mesh, beyond)[1] is None
    faces = mesh.faces.clone()
    faces[5, 1] = len(mesh.vertices) + 7
    assert queued(sdm.TriangleMesh(mesh.vertices, faces, check=False), grid)[1] is None


def test_the_room_that_a_band_leaves_for_the_next(monkeypatch):
    noted: list[graphs.Call] = []
    monkeypatch.setattr(graphs, "note", noted.append)
    monkeypatch.setattr(repeated_bands, "memory_of", lambda _: 1 << 36)
    repeated_bands._rooms.clear()
    mesh = sdm.TriangleMesh(*torus(3000))
    grid, index = sdm.Grid.around(mesh, 75), sdm.MeshIndex(mesh, "cpu")
    with plan_override(method="cells", slice_factors=(1,)):
        width = band_width(grid, 3.0)
        found = measured_blocks(index._structure, grid, width, signed=True, mesh=mesh, gaps=True)
        for _ in range(2):
            repeated_bands.note(mesh, grid, width, found)
        one, again = noted
        assert one.finish is not None
        made = one.finish(one.work(graphs.unverified, *one.inputs))
        assert made is not None
        assert_same(made, sdm.narrow_band(mesh, grid, device="cpu"))
        # A little smaller: the same recording will do.
        smaller = measured_blocks(index._structure, grid, 0.97 * width, signed=True, mesh=mesh, gaps=True)
        repeated_bands.note(mesh, grid, width, smaller)
        assert one.key == again.key == noted[2].key
        larger = measured_blocks(index._structure, grid, 2 * width, signed=True, mesh=mesh, gaps=True)
        repeated_bands.note(mesh, grid, width, larger)
        assert noted[3].key != one.key
    repeated_bands._rooms.clear()


@pytest.mark.parametrize(("triangles", "resolution"), [(20_000, 512), (1_000_000, 1024), (100_000, 4096)])
def test_a_pass_takes_no_more_than_a_gibibyte_for_its_lists(triangles, resolution):
    work = Workload(triangles, depth_for(triangles), 1, (resolution,) * 3, (0.01,) * 3, False)
    dense = make_plan(work, 80 << 30, PlanOptions())
    regions = 3000
    guessed = band_plan(dense, regions, triangles, True)
    assert guessed.passes * guessed.most >= regions
    assert guessed.chunks <= MOST_CHUNKS * 9 // 8
    # If few turn out to be needed, there is one pass, with as much room as that.
    known = band_plan(dense, regions, triangles, True, 5000)
    assert (known.passes, known.chunks, known.most) == (1, 5000, regions)
    many = band_plan(dense, regions, triangles, True, 3 * MOST_CHUNKS)
    assert many.passes >= 3
    assert many.chunks <= MOST_CHUNKS * 9 // 8


def test_few_launches(monkeypatch):
    """Nothing is read before the end; of torch's operations there are few."""
    from tests.unit.engine.band.test_launches import Counted

    mesh = sdm.TriangleMesh(*torus(3000))
    grid = sdm.Grid.around(mesh, 64)
    with plan_override(method="cells", slice_factors=(1,)):
        call = repeated_bands.band_call(mesh, grid, band_width(grid, 3.0), AMPLE)
        call.work(lambda flags: None, *call.inputs)
        with Counted() as counted:
            call.work(lambda flags: None, *call.inputs)
    assert counted.names.total() <= 8, counted.names
