"""Meshes that are written and read again."""

from __future__ import annotations

import numpy as np
import pytest

import sdm
from sdm.bench.common.meshes import sphere
from sdm.io.meshes.write import WRITERS


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("scale", [1.0, 1e-7, 1e9])
def test_triangles_come_back_bit_for_bit(ending, scale, tmp_path):
    vertices, faces = sphere(5)
    mesh = sdm.TriangleMesh(vertices * np.float32(scale / 3), faces)
    mesh.save(tmp_path / f"a.{ending}")
    back = sdm.load_mesh(tmp_path / f"a.{ending}")
    np.testing.assert_array_equal(back.vertices[back.faces.long()], mesh.vertices[mesh.faces.long()])


def test_other_endings(tmp_path):
    mesh = sdm.TriangleMesh(*sphere(3))
    with pytest.raises(sdm.FormatError, match=r"a\.dae does not end like a mesh .* use one of \.ply, \.stl"):
        sdm.save_mesh(mesh, tmp_path / "a.dae")
    assert not list(tmp_path.iterdir())
