"""Both devices give the same distances and signs, on every kind of mesh, for points, maps, batches and gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
import sdm.engine.structure.sizes
from sdm.bench.common.meshes import generated_names, load_case
from tests.helpers import oracle
from tests.helpers.exactness import ROUNDING, assert_exact, scale_of

pytestmark = pytest.mark.gpu


def _points(case, count: int) -> np.ndarray:
    rng = np.random.default_rng(4)
    low, high = case.box
    size = (high - low).max()
    corner = case.vertices[case.faces[rng.integers(0, len(case), count)]].astype(float)
    on = (rng.dirichlet(np.ones(3), count)[:, None] @ corner)[:, 0]
    parts = [
        rng.uniform(low - 0.2 * size, high + 0.2 * size, (count, 3)),
        on,
        on + size * 10.0 ** rng.uniform(-7, -2, (count, 1)) * rng.normal(size=(count, 3)),
        corner[:, 0] * [0, 1, 1] + np.array([low[0] - 0.5 * size, 0, 0]),
        low + 10 * size * rng.normal(size=(count, 3)),
    ]
    return np.concatenate(parts).astype(np.float32)


def _assert_same(cpu: torch.Tensor, gpu: torch.Tensor, limit: np.ndarray, sure: np.ndarray) -> None:
    cpu, gpu = cpu.reshape(-1), gpu.cpu().reshape(-1)
    assert ((cpu.abs() - gpu.abs()).abs().numpy() <= limit).all()
    clear = torch.from_numpy(sure)
    assert torch.equal((cpu < 0)[clear], (gpu < 0)[clear])


@pytest.mark.parametrize("name", generated_names())
def test_points(name):
    case = load_case(name)
    points = _points(case, 2000)
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    cpu, gpu = sdm.MeshIndex(mesh, "cpu"), sdm.MeshIndex(mesh, "cuda")
    limit = 4 * ROUNDING * scale_of(case.vertices, case.faces, points)
    winding = cpu.winding_number(points)
    # Off the surface, and off the threshold by more than either may be wrong.
    sure = ((winding - 0.5).abs().numpy() > 1e-3) & (cpu.signed_distance(points).abs().numpy() > limit)
    _assert_same(cpu.signed_distance(points), gpu.signed_distance(points), limit, sure)
    same = cpu.signed_distance(points).abs() > torch.from_numpy(100 * limit)
    torch.testing.assert_close(gpu.winding_number(points).cpu()[same], winding[same], atol=2e-3, rtol=0)
    if cpu.closed:
        assert torch.equal(gpu.winding_number(points).cpu()[sure], winding[sure])
    few = np.random.default_rng(0).choice(len(points), 300, replace=False)
    assert_exact(case.vertices, case.faces, points[few], gpu.signed_distance(points[few]))

    values, hit = gpu.signed_distance(points, return_closest=True)
    reach = (torch.from_numpy(points).double() - hit.points.cpu().double()).norm(dim=1)
    assert (
        (reach - values.cpu().double().abs()).abs().numpy()
        <= 6 * ROUNDING * scale_of(case.vertices, case.faces, points)
    ).all()


@pytest.mark.parametrize("name", generated_names())
def test_maps(name):
    case = load_case(name)
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    grid = sdm.Grid.around(mesh, resolution=37)
    cpu, gpu = sdm.signed_distance_map(mesh, grid, device="cpu"), sdm.MeshIndex(mesh, "cuda")
    centres = grid.points().reshape(-1, 3).numpy()
    limit = 4 * ROUNDING * scale_of(case.vertices, case.faces, centres)
    winding = sdm.MeshIndex(mesh, "cpu").winding_number(centres)
    sure = ((winding - 0.5).abs().numpy() > 1e-3) & (cpu.values.abs().reshape(-1).numpy() > limit)
    whole = gpu.signed_distance_map(grid)
    _assert_same(cpu.values, whole.values, limit, sure)
    slabs = torch.cat([values for _, _, values in gpu.slabs(grid, 4 * 5 * 37 * 37)])
    assert torch.equal(slabs, whole.values)
    assert torch.equal(gpu.signed_distance_map(grid).values, whole.values)
    few = np.random.default_rng(0).choice(len(centres), 300, replace=False)
    assert_exact(case.vertices, case.faces, centres[few], whole.values.reshape(-1)[torch.from_numpy(few).cuda()])


@pytest.mark.parametrize("edges", [0, 1024])
def test_batches(monkeypatch, edges):
    monkeypatch.setattr(sdm.engine.structure.sizes, "MOST_BOUNDARY_EDGES", edges)
    rng = np.random.default_rng(5)
    vertices = rng.normal(size=(5, 60, 3)).astype(np.float32)
    faces = rng.integers(0, 60, (120, 3)).astype(np.int32)
    grid = sdm.Grid([-2, -2, -2], [0.25, 0.3, 0.35], [17, 15, 13])
    cpu = sdm.signed_distance_maps(vertices, faces, grid, device="cpu")
    gpu = sdm.signed_distance_maps(vertices, faces, grid, device="cuda")
    assert gpu.is_cuda
    centres = grid.points().reshape(-1, 3).numpy()
    for one, values, other in zip(vertices, cpu, gpu, strict=True):
        limit = 4 * ROUNDING * scale_of(one, faces, centres)
        winding = oracle.winding_number(one, faces, centres)
        sure = (np.abs(winding - 0.5) > 1e-3) & (values.abs().reshape(-1).numpy() > limit)
        _assert_same(values, other, limit, sure)


def test_gradients():
    case = load_case("torus")
    # Off the planes of symmetry, where either of two triangles may be taken.
    grid = sdm.Grid([-0.987, -0.993, -0.397], [0.2, 0.2, 0.1], [10, 10, 8])
    results = []
    for device in ("cpu", "cuda"):
        leaf = torch.tensor(case.vertices, device=device, requires_grad=True)
        points = grid.points().to(device).requires_grad_()
        mesh = sdm.TriangleMesh(leaf, case.faces)
        loss = sdm.signed_distance(mesh, points, device=device).square().sum()
        loss = loss + sdm.signed_distance_map(mesh, grid, device=device).values.square().sum()
        loss = loss + sdm.signed_distance_maps(torch.stack([leaf, 2 * leaf]), case.faces, grid).square().sum()
        loss.backward()
        assert points.grad is not None
        assert leaf.grad is not None
        results.append((loss.detach().cpu(), points.grad.cpu(), leaf.grad.cpu()))
    torch.testing.assert_close(results[1][0], results[0][0])
    clear = (results[1][1] - results[0][1]).norm(dim=-1) < 1e-3
    assert clear.float().mean() > 0.99
    clear = (results[1][2] - results[0][2]).norm(dim=-1) < 1e-2
    assert clear.float().mean() > 0.99


def test_tensors_stay_where_they_are():
    case = load_case("torus")
    mesh = sdm.TriangleMesh(torch.tensor(case.vertices).cuda(), case.faces)
    index = sdm.MeshIndex(mesh)
    assert index.device.type == "cuda"
    assert index.mesh.vertices is mesh.vertices
    assert sdm.signed_distance(mesh, torch.zeros(4, 3)).is_cuda
    assert sdm.signed_distance(sdm.TriangleMesh(case.vertices, case.faces), torch.zeros(4, 3).cuda()).is_cuda
    assert index.signed_distance_map(sdm.Grid([0, 0, 0], [1, 1, 1], [2, 2, 2])).values.is_cuda


@pytest.mark.skipif(torch.cuda.device_count() < 2, reason="needs two CUDA devices")
def test_a_device_that_is_not_the_current_one():
    case = load_case("open hemisphere")
    points = _points(case, 2000)
    mesh = sdm.TriangleMesh(case.vertices, case.faces)
    values = sdm.MeshIndex(mesh, "cuda:1").signed_distance(points)
    assert values.device == torch.device("cuda:1")
    assert torch.equal(values.cpu(), sdm.MeshIndex(mesh, "cuda:0").signed_distance(points).cpu())
    assert torch.cuda.current_device() == 0
