"""Keys of either length sort triangles and edges into the same order."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.bench.common.mesh_formulas import torus
from sdm.engine.acceleration import ARRAYS
from sdm.kernels.bvh import build
from sdm.kernels.launches.arrays import SHORT_BITS, short_keys
from sdm.kernels.topology import edge_pairing


@pytest.mark.parametrize("triangles", [50, 2_000])
def test_same_bits_by_long_and_by_short_keys(triangles, monkeypatch):
    mesh = sdm.TriangleMesh(*torus(triangles))
    found = []
    for short in (False, True):
        for module in (build, edge_pairing):
            monkeypatch.setattr(module, "SHORT_BITS", SHORT_BITS if short else -1)
        index = sdm.MeshIndex(mesh, "cpu")
        tensors = dict(zip([(a.struct, a.name) for a in ARRAYS], index._structure.tensors, strict=True))
        found.append((tensors["tree", "face"].clone(), index.signed_distance_map(12).values))
    (order, values), (other, others) = found
    assert torch.equal(order, other)
    assert torch.equal(values, others)


@pytest.mark.parametrize(
    ("count", "expected"), [(2304, False), (2305, True), (4864, True), (4865, False), (700_000, True)]
)
def test_the_shorter_keys_where_they_are_quicker(count, expected):
    assert short_keys(count, SHORT_BITS) is expected
    assert not short_keys(count, SHORT_BITS + 1)
