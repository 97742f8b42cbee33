"""A default device that a program sets for torch changes no result: here "meta", on which nothing is computed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere
from sdm.shapes.registry import families

MESH = sdm.TriangleMesh(*sphere(8))
OPEN = sdm.TriangleMesh(MESH.vertices, MESH.faces[:-20])
GRID = sdm.Grid((-1.2,) * 3, (0.2,) * 3, (12,) * 3)
POINTS = torch.rand(50, 3, generator=torch.Generator().manual_seed(0), device="cpu")
LABELS = np.zeros((10, 10, 10), np.uint8)
LABELS[3:7, 3:6, 2:8], LABELS[7:9] = 1, 2


def gradients() -> torch.Tensor:
    points = POINTS.clone().requires_grad_()
    sdm.signed_distance(OPEN, points, device="cpu").sum().backward()
    assert points.grad is not None
    return points.grad


def band(mesh: sdm.TriangleMesh, **options: Any) -> sdm.SparseSDM:
    return sdm.narrow_band(mesh, 0.1, device="cpu", **options)


def stream() -> tuple[torch.Tensor, ...]:
    family = sdm.shapes.Cochlea(triangles=1000)
    batch = next(iter(sdm.SDMStream(family, family.grid(12), batch_size=2, seed=0, device="cpu")))
    return batch.theta, batch.sdm


def of_family(name: str) -> torch.Tensor:
    family = families[name].example()
    return family.vertices(family.sample(2, device="cpu"))


CALLS: dict[str, Callable[[], Any]] = {
    "closed": lambda: sdm.signed_distance_map(MESH, GRID, device="cpu").values,
    "open": lambda: sdm.signed_distance_map(OPEN, 16, device="cpu", compare_signs=True).values,
    "closest": lambda: sdm.signed_distance_map(OPEN, GRID, device="cpu", return_closest=True)[1].points,
    "flood": lambda: sdm.signed_distance_map(OPEN, GRID, device="cpu", sign="flood").values,
    "auto": lambda: sdm.signed_distance_map(OPEN, GRID, device="cpu", orient="auto").values,
    "parts": lambda: sdm.signed_distance_map(OPEN, GRID, device="cpu", orient="parts", sign="none").values,
    "arrays": lambda: sdm.signed_distance_map((MESH.vertices.numpy(), MESH.faces.numpy()), 12, device="cpu").values,
    "points": lambda: sdm.signed_distance(OPEN, POINTS, device="cpu", return_closest=True)[1].points,
    "gradients": gradients,
    "index": lambda: sdm.MeshIndex(OPEN, "cpu").winding_number(POINTS),
    "batch": lambda: sdm.signed_distance_maps(torch.stack([MESH.vertices] * 2), MESH.faces, GRID),
    "list": lambda: [field.values for field in sdm.signed_distance_maps([MESH, OPEN], GRID, device="cpu")],
    "points of a list": lambda: sdm.signed_distances([MESH, OPEN], [POINTS, POINTS], device="cpu"),
    "band": lambda: (band(OPEN).values, band(MESH).to_dense().values, band(MESH).to_mesh().vertices),
    "band of a flood": lambda: band(OPEN, sign="flood").values,
    "surface": lambda: sdm.signed_distance_map(MESH, GRID, device="cpu").to_mesh(method="dual").vertices,
    "sample": lambda: sdm.signed_distance_map(MESH, GRID, device="cpu").sample(POINTS),
    "watertight": lambda: sdm.watertight(OPEN, resolution=24, device="cpu").vertices,
    "faces": lambda: sdm.orient_faces(OPEN).faces,
    "transform": lambda: torch.as_tensor(sdm.euclidean_distance_transform(LABELS, classes=[1, 2]), device="cpu"),
    "stream": stream,
    **{name: lambda name=name: of_family(name) for name in families},
}


@pytest.mark.parametrize("name", CALLS)
def test_results_are_those_without_a_default(name):
    call = CALLS[name]
    # First, while nothing is in a cache yet that a usual call would have filled.
    with torch.device("meta"):
        found = call()
    expected = call()
    pairs = [(expected, found)] if isinstance(expected, torch.Tensor) else list(zip(expected, found, strict=True))
    for one, other in pairs:
        assert one.device == other.device
        assert torch.equal(one, other)
