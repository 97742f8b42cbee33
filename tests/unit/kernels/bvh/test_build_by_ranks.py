"""A tree whose triangles are ordered by ranks, as a GPU does it, and by a radix sort: the same, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp

from sdm.bench.common.mesh_formulas import sphere, torus
from sdm.engine.acceleration import ARRAYS, AccelerationStructure, MeshKind, Sizes
from sdm.kernels.bvh import build
from sdm.kernels.bvh.rank_sort import COMPARED, is_ranked
from sdm.kernels.bvh.tree import BOX_FLOATS

BITS = 24
MESHES = {
    "few": sphere(20),
    "sphere": sphere(40),
    "torus": torus(20_000),
    "all alike": (np.eye(3, dtype=np.float32), np.tile(np.array([[0, 1, 2]], np.int32), (3000, 1))),
}


def _tree_of(vertices: np.ndarray, faces: np.ndarray) -> list[bytes]:
    count = len(faces)
    structure = AccelerationStructure.in_block(Sizes(1, count, 0, MeshKind.CLOSED), torch.device("cpu"))
    # Memory that was used before.
    keys = wp.full(2 * count, -1, dtype=wp.int64, device="cpu")
    slots = wp.full(2 * count, -1, dtype=wp.int32, device="cpu")
    bounds, normals = (wp.full(n, -7.0, dtype=wp.float32, device="cpu") for n in (6, 4 * count))
    corners = wp.array(vertices, dtype=wp.vec3, device="cpu").reshape((1, len(vertices)))
    triples = wp.array(faces, dtype=wp.int32, device="cpu")
    build.build_tree(structure.view.tree, corners, triples, bounds, keys, slots, normals)
    made = [t for array, t in zip(ARRAYS, structure.tensors, strict=True) if array.struct == "tree"]
    # There is no node 0.
    begin = [4 * BOX_FLOATS * (array.name == "boxes") for array in ARRAYS if array.struct == "tree"]
    found = [tensor.numpy()[at:].tobytes() for tensor, at in zip(made, begin, strict=True)]
    return [*found, bounds.numpy().tobytes(), normals.numpy().tobytes()]


@pytest.mark.parametrize("name", list(MESHES))
def test_the_same_tree(monkeypatch, name):
    vertices, faces = MESHES[name]
    assert is_ranked(len(faces), 1, False, BITS)
    assert (len(faces) <= COMPARED) == (name == "few")
    expected = _tree_of(vertices, faces)
    asked: list[bool] = []
    monkeypatch.setattr(build, "_is_ranked", lambda *_: asked.append(True) or True)
    assert _tree_of(vertices, faces) == expected
    assert asked
