"""Boxes of lists of meshes are those of each."""

from __future__ import annotations

import numpy as np
import pytest

import sdm
from sdm.bench.common.meshes import cube, sphere
from sdm.engine.ragged.boxes import with_known_boxes


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_boxes_are_those_of_the_meshes(device):
    vertices, faces = sphere(9)
    loose = np.concatenate([vertices, [[9, 9, 9]]]).astype(np.float32)
    meshes = [sdm.TriangleMesh(v, f, name).to(device) for v, f, name in ((*cube(), "a"), (loose, faces, "b"))]
    for mesh, found in zip(meshes, with_known_boxes(meshes), strict=True):
        assert found.device.type == "cpu"
        assert found.name == mesh.name
        assert np.array_equal(found.bounds, mesh.bounds)
