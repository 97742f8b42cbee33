"""Maps by capacity class: the bits of calls for a mesh's own counts, for every mesh and grid of a class."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case
from sdm.bench.dense.first import split
from sdm.engine.capacity.classes import bounds_of, class_of
from sdm.engine.capacity.closed_maps import class_call, to_record
from sdm.kernels.bvh.tree import depth_for
from sdm.topology.face_pairing import neighbours


def _class_map(vertices, faces, grid):
    kind = class_of(faces.shape[0], vertices.shape[0], grid, None)
    call = to_record(kind, class_call(kind, vertices, faces, grid))
    flags = []
    values, around = call.work(flags.append, *call.inputs)
    return kind, values[0], around[: faces.shape[0]], flags[0]


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
    assert not flags.any()
    assert torch.equal(around, neighbours(faces, len(vertices)))
    assert torch.equal(values, sdm.MeshIndex((vertices, faces), "cpu", warn=False).signed_distance_map(grid).values)


def test_meshes_of_a_class_have_one_recording():
    case = load_case("torus-1000")
    kinds = set()
    for number in (3, 50, 100):
        other = split(case, number)
        low, _ = other.box
        grid = sdm.Grid(low - 0.01 * number, [0.1 + 0.001 * number] * 3, (20, 20, 20))
        kinds.add(class_of(len(other), len(other.vertices), grid, None))
    assert len(kinds) == 1


def test_open_meshes_and_wrong_indices_are_told():
    case = load_case("torus-1000")
    vertices, faces = torch.from_numpy(case.vertices), torch.from_numpy(case.faces)
    grid = sdm.Grid([-1] * 3, [0.2] * 3, [10] * 3)
    last = len(vertices) - 1
    for wrong in (faces[1:].contiguous(), faces.where(faces != 7, last + 1), faces.where(faces != 7, -1)):
        assert _class_map(vertices, wrong, grid)[3].any()


@pytest.mark.parametrize("faces", [1, 1280, 1281, 5120, 5121, 20480, 20481, 30720, 30721, 40960, 1_000_000])
def test_bounds(faces):
    least, most = bounds_of(faces)
    assert least <= faces <= most
    assert bounds_of(least) == bounds_of(most) == (least, most)
    if faces > 20480:
        assert depth_for(least) == depth_for(most)
        assert most + 1 - least <= most / 3 + 1


def test_no_class_for_what_is_searched_voxel_by_voxel():
    grid = sdm.Grid([0] * 3, [1] * 3, [4] * 3)
    assert class_of(1 << 20, 1 << 19, grid, None) is None
