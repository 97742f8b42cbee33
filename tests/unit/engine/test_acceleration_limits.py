"""More triangles than the kernels can count are refused before any memory is taken."""

from __future__ import annotations

import pytest
import torch

from sdm.bench.common.meshes import cube
from sdm.engine.acceleration import build
from sdm.errors import MeshError


def test_too_many_triangles():
    vertices, faces = (torch.tensor(array) for array in cube())
    batch = vertices[None].expand(10_000_000, -1, -1)
    with pytest.raises(MeshError, match="10,000,000 meshes of 12 triangles are more than the 100,000,000"):
        build(batch, faces)
