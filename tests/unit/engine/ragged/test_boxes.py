"""Boxes of lists of meshes are those of each."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube, sphere
from sdm.engine.ragged.boxes import boxes_of, with_known_boxes


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_boxes_are_those_of_the_meshes(device):
    vertices, faces = sphere(9)
    loose = np.concatenate([vertices, [[9, 9, 9]]]).astype(np.float32)
    meshes = [sdm.TriangleMesh(v, f, name).to(device) for v, f, name in ((*cube(), "a"), (loose, faces, "b"))]
    for mesh, found in zip(meshes, with_known_boxes(meshes), strict=True):
        assert found.device.type == "cpu"
        assert found.name == mesh.name
        assert np.array_equal(found.bounds, mesh.bounds)


def test_all_boxes_at_once():
    rng = np.random.default_rng(0)
    meshes = []
    for count in (3, 40, 7):
        faces = rng.integers(0, count, (5, 3))
        meshes.append(sdm.TriangleMesh(rng.normal(size=(count, 3)), faces, check=False))
    vertices, faces = meshes[1].vertices, meshes[1].faces.clone()
    faces[0, 0] = 99
    meshes[1] = sdm.TriangleMesh(vertices, faces, check=False)
    found = boxes_of(meshes)
    assert found.shape == (3, 3, 3)
    for mesh, box in zip(meshes, found, strict=True):
        used = mesh.vertices[mesh.faces.reshape(-1).long().clamp(max=len(mesh.vertices) - 1)]
        assert torch.equal(box, torch.stack([used.amin(0), used.amax(0), used.amin(0)]))
