"""torch.library.opcheck of every operator: schema, fake tensors, autograd registration, dispatch under AOT."""

from __future__ import annotations

import pytest
import torch

import sdm
import sdm.engine.ops
import sdm.engine.structure.sizes
from sdm.bench.common.meshes import sphere
from sdm.engine.acceleration import build


def _inputs(prebuilt: bool, gradients: bool, missing: int, meshes: int = 1) -> tuple:
    vertices, faces = sphere(4)
    batch = torch.tensor(vertices).repeat(meshes, 1, 1)
    index = torch.tensor(faces[missing:].copy())
    if not prebuilt:
        return batch.requires_grad_(gradients), index, [], 0
    structure = build(batch, index)
    return batch.requires_grad_(gradients), index, structure.tensors, int(structure.kind)


@pytest.fixture(params=[(False, False, 0), (True, False, 0), (True, True, 0), (False, True, 3), (True, True, 3)])
def case(request):
    return request.param


def _points(gradients: bool, count: int = 11) -> torch.Tensor:
    return torch.randn(count, 3, generator=torch.Generator().manual_seed(0)).requires_grad_(gradients)


@pytest.mark.parametrize("name", ["distance", "winding_number"])
@pytest.mark.parametrize("prebuilt", [False, True])
@pytest.mark.parametrize("missing", [0, 3])
def test_without_gradients(name, prebuilt, missing):
    vertices, faces, tensors, kind = _inputs(prebuilt, False, missing)
    op = getattr(torch.ops.sdm, name).default
    torch.library.opcheck(op, (vertices[0], faces, _points(False), tensors, kind))
    torch.library.opcheck(op, (vertices[0], faces, _points(False, 0), tensors, kind))


def test_closest(case):
    prebuilt, gradients, missing = case
    vertices, faces, tensors, kind = _inputs(prebuilt, gradients, missing)
    leaf = vertices[0].detach().requires_grad_(gradients)
    torch.library.opcheck(torch.ops.sdm.closest.default, (leaf, faces, _points(gradients), tensors, kind))


STRAIGHT, TURNED = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [0.8, -0.6, 0.0, 0.6, 0.8, 0.0, 0.0, 0.0, 1.0]


# The others' ways are those of one mesh, below.
@pytest.mark.parametrize("case", [(True, False, 0), (True, True, 0), (False, True, 3)])
def test_distance_maps(case):
    _check_maps(case, 3, TURNED)


@pytest.mark.parametrize("case", [(False, False, 0), (True, True, 3)])
def test_distance_map(case):
    _check_maps(case, 1, STRAIGHT)


def _check_maps(case: tuple[bool, bool, int], meshes: int, direction: list[float]) -> None:
    vertices, faces, tensors, kind = _inputs(*case, meshes)
    arguments = (vertices, faces, tensors, kind, [-1.0, -1, -1], [0.5, 0.6, 0.7], [3, 4, 2], 1, direction)
    torch.library.opcheck(torch.ops.sdm.distance_map.default, arguments)


def test_soup(monkeypatch):
    monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_BOUNDARY_EDGES", 0)
    vertices, faces, tensors, kind = _inputs(True, True, 3)
    leaf = vertices[0].detach().requires_grad_()
    torch.library.opcheck(torch.ops.sdm.closest.default, (leaf, faces, _points(True), tensors, kind))


def test_points_with_gaps_in_memory():
    """Operators take any layout."""
    vertices, faces, tensors, kind = _inputs(True, False, 0)
    wide = torch.randn(20, 6, generator=torch.Generator().manual_seed(1))
    whole = torch.ops.sdm.distance(vertices[0], faces, wide[::2, 1:4].contiguous(), tensors, kind)
    assert torch.equal(torch.ops.sdm.distance(vertices[0], faces, wide[::2, 1:4], tensors, kind), whole)
