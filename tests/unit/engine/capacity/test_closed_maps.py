"""Maps by capacity class: the bits of calls for a mesh's own counts, for every mesh and grid of a class."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case
from sdm.bench.dense.first import split
from sdm.engine.capacity.class_calls import class_call
from sdm.engine.capacity.classes import bounds_of, class_of
from sdm.engine.capacity.tables import TABLE, write_table
from sdm.engine.plan_override import plan_override
from sdm.kernels.bvh.tree import COUNT, FIRST, LEFT_OUT, PART_SIZE, ROOT, depth_for
from sdm.kernels.dense.plan import Workload, decide
from sdm.kernels.geometry.voxel_grid import AXES, CELL_SHARES, ORIGIN, REGION, REGION_SHARES, SHAPE, SLAB_ROW, VOXEL
from sdm.kernels.plan_options import PlanOptions
from sdm.kernels.topology.filler_faces import ADDRESSES, COUNTS
from sdm.topology.face_pairing import neighbours
from tests.helpers.by_table import by_table


def _class_map(vertices, faces, grid):
    kind, decisions = class_of(faces.shape[0], vertices.shape[0], grid, None)
    given = vertices, faces, grid, len(vertices), len(faces), faces.device
    found, flags, told = by_table(class_call(kind, decisions, given))
    assert told == 0
    return kind, found.values, found.told.neighbours, flags


@pytest.mark.parametrize("name", ["torus-1000", "touching cubes", "needle box", "nested shells", "zero-area faces"])
@pytest.mark.parametrize("turned", [False, True])
def test_the_same_bits(name, turned):
    case = load_case(name)
    case = split(case, len(case) // 7)
    vertices, faces = torch.from_numpy(case.vertices), torch.from_numpy(case.faces)
    low, high = case.box
    direction = [[0, 1, 0], [1, 0, 0], [0, 0, 1]] if turned else np.eye(3)
    grid = sdm.Grid(low - 0.07, (high - low).max() / 20 * np.ones(3), (24, 20, 27), direction)
    _, values, around, flags = _class_map(vertices, faces, grid)
    assert not any(flags)
    assert torch.equal(around, neighbours(faces, len(vertices)))
    assert torch.equal(values, sdm.MeshIndex((vertices, faces), "cpu", warn=False).signed_distance_map(grid).values)


def test_lists_in_shares():
    """As on a GPU: each list is made by several groups, whose number is in the table."""
    case = load_case("torus-5000")
    vertices, faces = torch.from_numpy(case.vertices), torch.from_numpy(case.faces)
    grid = sdm.Grid([-1.1] * 3, [0.08] * 3, [28] * 3)
    with plan_override(shares=(8, 2), split_length=32, slice_factors=(1,)):
        kind, values, _, _ = _class_map(vertices, faces, grid)
        assert (kind.plan.region_shares, kind.plan.cell_shares) == (8, 2)
        assert torch.equal(values, sdm.MeshIndex((vertices, faces), "cpu").signed_distance_map(grid).values)


def test_lists_by_brick():
    """As on a large grid on a GPU: bricks of cells of 16^3 voxels have lists of their own."""
    case = load_case("torus-5000")
    vertices, faces = torch.from_numpy(case.vertices), torch.from_numpy(case.faces)
    # So fine that no cell is coarse.
    grid = sdm.Grid([-1.0, -0.3, -0.3], [0.01] * 3, [60, 45, 50])
    for by_brick in (True, False):
        with plan_override(
            cell=16, by_brick=by_brick, list_split=16, split_length=64, shares=(8, 2), slice_factors=(1,)
        ):
            kind, values, _, _ = _class_map(vertices, faces, grid)
            assert kind.plan.by_brick == by_brick
            assert torch.equal(values, sdm.MeshIndex((vertices, faces), "cpu").signed_distance_map(grid).values)
            if by_brick:
                first = values
    assert torch.equal(values, first)


def test_the_table_has_every_entry_in_its_place():
    grid = sdm.Grid([1, 2, 3], [0.1, 0.2, 0.3], [10, 11, 12], [[0, 1, 0], [1, 0, 0], [0, 0, 1]])
    kind, decisions = class_of(1000, 500, grid, None)
    decisions = decisions._replace(region_shares=4, cell_shares=2, levels_left_out=3)
    table = np.zeros(TABLE)
    write_table(memoryview(table), kind, decisions, 1000, 500, grid, (11, 12, 13, 14, 15))
    own, none = table[: 2 * SLAB_ROW].reshape(2, SLAB_ROW)
    assert tuple(own[ORIGIN : ORIGIN + 3]) == (1, 2, 3)
    assert tuple(own[SHAPE : SHAPE + 3]) == (10, 11, 12)
    assert tuple(own[AXES : AXES + 9]) == (0, 0.2, 0, 0.1, 0, 0, 0, 0, 0.3)
    assert tuple(none[SHAPE : SHAPE + 3]) == (0, 0, 0)
    assert (none[VOXEL], none[REGION]) == (grid.size, kind.plan.total)
    assert table[2 * SLAB_ROW :].view(np.int64)[:ADDRESSES].tolist() == [11, 12, 13, 14, 15]
    numbers = table[2 * SLAB_ROW + ADDRESSES :].view(np.int32)
    assert numbers[:COUNTS].tolist() == [1000, 500]
    parts = numbers[COUNTS:][: 2 * PART_SIZE].reshape(2, PART_SIZE)
    assert parts[:, FIRST].tolist() == [0, 1000]
    assert parts[:, COUNT].tolist() == [1000, 1]
    assert parts[:, ROOT].tolist() == [0, 2 << depth_for(1000)]
    assert parts[:, LEFT_OUT].tolist() == [3, 0]
    assert (own[REGION_SHARES], own[CELL_SHARES]) == (4, 2)


def test_a_table_is_that_of_its_own_mesh_whatever_was_written_before():
    grids = [sdm.Grid([k, 2, 3], [0.1 + k] * 3, [10, 11, 12]) for k in range(2)]
    kind, decisions = class_of(1000, 500, grids[0], None)
    again = np.zeros(TABLE)
    for k, grid in enumerate(grids):
        fresh = np.zeros(TABLE)
        for table in (fresh, again):
            own = decisions._replace(region_shares=4 - k, cell_shares=2)
            write_table(memoryview(table), kind, own, 900 + k, 500 - k, grid, range(ADDRESSES))
        assert fresh.tobytes() == again.tobytes()


def test_meshes_of_a_class_have_one_recording():
    case = load_case("torus-1000")
    kinds = set()
    for number in (3, 50, 100):
        other = split(case, number)
        low, _ = other.box
        grid = sdm.Grid(low - 0.01 * number, [0.1 + 0.001 * number] * 3, (20, 20, 20))
        kinds.add(class_of(len(other), len(other.vertices), grid, None)[0])
    assert len(kinds) == 1


def test_open_meshes_and_wrong_indices_are_told():
    case = load_case("torus-1000")
    vertices, faces = torch.from_numpy(case.vertices), torch.from_numpy(case.faces)
    grid = sdm.Grid([-1] * 3, [0.2] * 3, [10] * 3)
    last = len(vertices) - 1
    for wrong in (faces[1:].contiguous(), faces.where(faces != 7, last + 1), faces.where(faces != 7, -1)):
        assert any(_class_map(vertices, wrong, grid)[3])


@pytest.mark.parametrize("faces", [1, 1620, 1621, 4863, 4864, 20480, 20481, 81920, 81921, 122880, 122881, 1_000_000])
def test_bounds(faces):
    least, most = bounds_of(faces)
    assert least <= faces <= most
    assert bounds_of(least) == bounds_of(most) == (least, most)
    if faces > 81920:
        assert depth_for(least) == depth_for(most)
        assert most + 1 - least <= most / 3 + 1


def test_no_class_for_what_is_searched_voxel_by_voxel():
    grid = sdm.Grid([0] * 3, [1] * 3, [4] * 3)
    assert class_of(1 << 20, 1 << 19, grid, None) is None


@pytest.mark.parametrize("gpu", [False, True])
@pytest.mark.parametrize(
    "shape", [(15, 15, 15), (64, 64, 64), (96, 96, 96), (256, 256, 256), (512, 512, 512), (40, 33, 90)]
)
def test_a_class_has_room_for_what_is_decided_about_each_of_its_meshes(gpu, shape):
    memory, grid = 1 << 36 if gpu else None, sdm.Grid([0] * 3, [1] * 3, shape)
    faces = 1
    while faces <= 500_000:
        least, most = bounds_of(faces)
        for count in {*range(least, most, max(1, (most - least) // 150)), most}:
            found = class_of(count, count // 2, grid, memory)
            expected = decide(
                Workload(count, depth_for(count), 1, shape, grid.spacing, turned=False), gpu, PlanOptions()
            )
            if found is None:
                # A CPU has less room.
                assert expected.method == "search" or not gpu
                continue
            kind, decisions = found
            assert decisions == expected
            assert kind.plan.cell == expected.cell
            assert not kind.plan.by_brick or kind.plan.cell == 16
            assert kind.plan.region_shares >= expected.region_shares
            assert kind.plan.cell_shares >= expected.cell_shares
            assert kind.plan.levels_left_out >= expected.levels_left_out
        faces = most + 1
