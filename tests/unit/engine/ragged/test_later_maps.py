"""Maps of a list on a GPU, whose values and warnings are made when somebody reads them; here so on a CPU."""

from __future__ import annotations

import copy
import io
import pickle

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube, sphere
from sdm.engine.ragged import calls

BALL, CUBE = sdm.TriangleMesh(*sphere(10)), sdm.TriangleMesh(*cube())
INWARD = BALL.flipped()
GRID = sdm.Grid.around(CUBE, (5, 6, 7))


@pytest.fixture
def read_later(monkeypatch):
    monkeypatch.setattr(calls, "is_read_later", lambda device: True)


def is_made(field: sdm.SDM) -> bool:
    return "values" in field.__dict__


@pytest.mark.usefixtures("read_later")
def test_values_are_made_when_they_are_read():
    fields = sdm.signed_distance_maps([BALL, CUBE], GRID, device="cpu")
    assert not any(map(is_made, fields))
    assert [(field.grid, field.ambiguous_voxels, field.sign) for field in fields] == [(GRID, 0, "winding")] * 2
    assert fields[0].truncated is None
    assert fields[0].shape == (5, 6, 7)
    assert not any(map(is_made, fields))
    for field, mesh in zip(fields, (BALL, CUBE), strict=True):
        alone = sdm.signed_distance_map(mesh, GRID, device="cpu")
        assert torch.equal(field.values, alone.values)
        assert field.values is field.values
        assert field.inside_voxels == alone.inside_voxels
        assert str(field) == str(alone)


@pytest.mark.usefixtures("read_later")
@pytest.mark.parametrize("through", ["pickle", "torch", "copy", "to", "numpy"])
def test_they_are_maps_like_any(through):
    (field, _) = sdm.signed_distance_maps([BALL, CUBE], GRID, device="cpu")
    expected = sdm.signed_distance_map(BALL, GRID, device="cpu").numpy()
    if through == "torch":
        memory = io.BytesIO()
        torch.save(field, memory)
        memory.seek(0)
        found = torch.load(memory)
    else:
        found = {
            "pickle": lambda: pickle.loads(pickle.dumps(field)),
            "copy": lambda: copy.copy(field),
            "to": lambda: field.to("cpu"),
            "numpy": lambda: field,
        }[through]()
    assert np.array_equal(np.asarray(found), expected)
    with pytest.raises(AttributeError, match="'SDM' object has no attribute 'nothing'"):
        _ = found.nothing


@pytest.mark.usefixtures("read_later")
def test_a_doubt_is_said_when_the_map_is_read():
    fields = sdm.signed_distance_maps([BALL, INWARD, INWARD], sdm.Grid.around(BALL, 8), device="cpu")
    with pytest.warns(sdm.SDMWarning, match=r"^mesh 1: mesh: the mesh is inside out"):
        fields[1].numpy()
    assert fields[1].inside_voxels == 0
    with pytest.warns(sdm.SDMWarning, match=r"^mesh 2: "):
        _ = fields[2].inside_voxels


@pytest.mark.usefixtures("read_later")
def test_vertices_written_into_meanwhile_are_not_judged():
    moved = sdm.TriangleMesh(INWARD.vertices.clone(), INWARD.faces)
    fields = sdm.signed_distance_maps([moved, BALL], sdm.Grid.around(BALL, 8), device="cpu")
    moved.vertices.mul_(-1)
    fields[0].numpy()


def test_as_many_operations_for_many_meshes_as_for_few(read_later):
    from torch.profiler import ProfilerActivity, profile

    def operations(count: int) -> int:
        meshes = [sdm.TriangleMesh(CUBE.vertices.clone(), CUBE.faces.clone(), check=False) for _ in range(count)]
        with profile(activities=[ProfilerActivity.CPU]) as seen:
            sdm.signed_distance_maps(meshes, [GRID] * count, device="cpu")
        return sum(event.count for event in seen.key_averages() if event.key.startswith("aten::"))

    assert operations(24) <= operations(3)
