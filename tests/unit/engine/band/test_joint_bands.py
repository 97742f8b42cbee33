"""Lists of meshes, whose bands are read together on a GPU: each is the band of its own call, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere, torus
from sdm.engine.band import joint_bands, listed_blocks


def meshes() -> list[sdm.TriangleMesh]:
    """Closed ones, an open one, one that is there many times, and one that is nowhere near its grid."""
    whole, ring = sdm.TriangleMesh(*sphere(9)), sdm.TriangleMesh(*torus(2000))
    opened = sdm.TriangleMesh(whole.vertices, whole.faces[5:])
    copies = sdm.TriangleMesh(whole.vertices[:3], np.tile([[0, 1, 2]], (400, 1)))
    return [whole, ring, opened, copies, sdm.TriangleMesh(*sphere(5)), whole]


def grids(given: list[sdm.TriangleMesh]) -> list[sdm.Grid]:
    found = [sdm.Grid.around(mesh, size) for mesh, size in zip(given, (40, 61, 33, 30, 24, 50), strict=True)]
    # Away from its mesh, and one that its mesh reaches beyond.
    found[4] = sdm.Grid((9.0, 9.0, 9.0), (0.1, 0.1, 0.1), (20, 20, 20))
    found[5] = sdm.Grid(found[5].origin, found[5].spacing, (25, 50, 50))
    return found


def assert_same(found: list[sdm.SparseSDM], wanted: list[sdm.SparseSDM]) -> None:
    for one, other in zip(found, wanted, strict=True):
        for name in ("blocks", "values", "inside"):
            assert torch.equal(getattr(one, name), getattr(other, name))
        assert (one.ambiguous_voxels, one.sign, one.width, one.grid) == (
            other.ambiguous_voxels,
            other.sign,
            other.width,
            other.grid,
        )


@pytest.fixture
def joint(monkeypatch):
    monkeypatch.setattr(joint_bands, "DEVICES", ("cpu",))
    made: list[bool] = []
    plain = joint_bands.joint_bands

    def counted(asked):
        for place, found in plain(asked):
            made.append(found is not None)
            yield place, found

    monkeypatch.setattr(joint_bands, "joint_bands", counted)
    return made


@pytest.mark.filterwarnings("ignore::sdm.SDMWarning")
@pytest.mark.parametrize("most", [1, 2, 64])
@pytest.mark.parametrize("measured", [1, 1 << 18])
def test_the_bits_of_single_calls(joint, monkeypatch, most, measured):
    given = meshes()
    wanted = [sdm.narrow_band(mesh, grid, device="cpu") for mesh, grid in zip(given, grids(given), strict=True)]
    monkeypatch.setattr(joint_bands, "MOST_MESHES", most)
    monkeypatch.setattr(joint_bands, "MOST_MEASURED", measured)
    assert_same(sdm.narrow_band(given, grids(given), device="cpu"), wanted)
    # One by one nothing is joint.
    assert joint.count(True) == (0 if most == 1 else 3)
    monkeypatch.setattr(joint_bands, "MOST_ROOM", 1)
    assert_same(sdm.narrow_band(given, grids(given), device="cpu"), wanted)
    # As of grids with very many blocks.
    monkeypatch.setattr(listed_blocks, "MOST_BITS", 0)
    assert_same(sdm.narrow_band(given, grids(given), device="cpu"), wanted)


def test_other_signs_are_made_alone(joint):
    given = meshes()[:3]
    for sign in ("none", "flood"):
        wanted = [sdm.narrow_band(mesh, 0.2, sign=sign, device="cpu") for mesh in given]
        assert_same(sdm.narrow_band(given, 0.2, sign=sign, device="cpu"), wanted)
    assert not joint


def test_a_face_out_of_range_is_an_error(joint):
    bad = sdm.TriangleMesh(*sphere(4), check=False)
    bad.faces[3, 1] = 1000
    with pytest.raises(sdm.MeshError, match="vertex 1000"):
        sdm.narrow_band([sdm.TriangleMesh(*sphere(4)), bad], sdm.Grid.around(meshes()[0], 20), device="cpu")
