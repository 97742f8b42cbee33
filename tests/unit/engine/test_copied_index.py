"""Copies of a mesh index: in a module that is copied, in another process, in a file of torch."""

from __future__ import annotations

import copy
import io
import pickle

import pytest
import torch

import sdm
from sdm.bench.common.meshes import torus


def by_torch(index: sdm.MeshIndex) -> sdm.MeshIndex:
    file = io.BytesIO()
    torch.save(index, file)
    file.seek(0)
    return torch.load(file, weights_only=False)


COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda index: pickle.loads(pickle.dumps(index)), "torch": by_torch}


@pytest.mark.parametrize("way", COPIES)
def test_copies_answer_alike_and_move_alone(way):
    index = sdm.MeshIndex(sdm.TriangleMesh(*torus(500)), "cpu")
    index.update(1.5 * index.mesh.vertices)
    points = torch.rand(50, 3) * 3 - 1.5
    before = index.signed_distance(points)
    other = COPIES[way](index)
    assert torch.equal(other.signed_distance(points), before)
    other.update(other.mesh.vertices + 1)
    assert torch.equal(index.signed_distance(points), before)


def test_a_copy_of_vertices_with_a_history_has_none():
    scale = torch.ones(1, requires_grad=True)
    vertices, faces = torus(500)
    index = sdm.MeshIndex(sdm.TriangleMesh(torch.as_tensor(vertices) * scale, faces), "cpu")
    assert index.signed_distance(torch.rand(3, 3)).requires_grad
    assert not copy.deepcopy(index).signed_distance(torch.rand(3, 3)).requires_grad
