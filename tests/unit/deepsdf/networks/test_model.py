"""Signed distances without a mesh, and their normals."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.nn.functional import normalize

from sdm import Grid
from sdm.deepsdf import DeepSDF, local
from sdm.deepsdf.networks.auto_decoder import AutoDecoder
from sdm.deepsdf.samples import UnitSphere
from sdm.errors import SDMError


def model(trained: bool = False) -> DeepSDF:
    """A ball of radius a half; or a network of random weights that stands for a trained one."""
    settings = local(width=16, layers=2, global_size=4, grids=((2, 2),), frequencies=1)
    network = AutoDecoder(settings, 2).decoder
    if trained:
        torch.nn.init.normal_(network.last.weight, std=0.1, generator=torch.Generator().manual_seed(0))
    codes = torch.randn(2, settings.code_size, generator=torch.Generator().manual_seed(1))
    return DeepSDF(settings, network, codes, ["a", "b"], [])


def test_distances_are_in_the_spheres_unit_and_in_the_shape_of_the_points() -> None:
    it, sphere = model(), UnitSphere((1.0, 2.0, 3.0), 10.0)
    points = np.random.default_rng(0).uniform(-6.9, 10.9, (4, 5, 3))
    values = it.signed_distance(points, it.codes[0], sphere)
    assert values.shape == (4, 5)
    assert np.abs(values.numpy() - (np.linalg.norm(points - sphere.centre, axis=-1) - 5)).max() < 1e-5


def test_beyond_the_box_the_way_to_it_is_added() -> None:
    it = model()
    values = it.signed_distance([[3.0, 0, 0], [0, -2, 0], [4, 5, 1]], it.codes[0])
    assert values.tolist() == pytest.approx([2.5, 1.5, 3**0.5 - 0.5 + 5.0])


def test_chunks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    it, points = model(trained=True), torch.rand(1000, 3) * 2 - 1
    whole = it.signed_distance(points, it.codes[0])
    monkeypatch.setattr("sdm.deepsdf.networks.model.CHUNK", 64)
    assert torch.allclose(it.signed_distance(points, it.codes[0]), whole, atol=1e-6)


def test_normals_are_the_gradient_of_autograd_and_of_differences() -> None:
    it, sphere = model(trained=True), UnitSphere((1.0, 0.0, -1.0), 3.0)
    points = (torch.rand(50, 3) * 2 - 1) * 1.5 + torch.tensor(sphere.centre)
    normals = it.normals(points, it.codes[1], sphere)
    at = points.clone().requires_grad_()
    it.signed_distance(at, it.codes[1], sphere).sum().backward()
    assert at.grad is not None
    assert torch.allclose(normals, normalize(at.grad, dim=-1), atol=1e-6)
    step = 0.01 * torch.eye(3)
    ends = [it.signed_distance(points[:, None] + s * step, it.codes[1], sphere) for s in (1, -1)]
    # A cell's border of the code grid within a step bends the difference, not the gradient.
    inner = ((points - torch.tensor(sphere.centre)).abs() > 0.05).all(1)
    assert torch.allclose(normalize(ends[0] - ends[1], dim=-1)[inner], normals[inner], atol=5e-3)


def test_codes_are_differentiable_too() -> None:
    it = model(trained=True)
    code = it.codes[0].clone().requires_grad_()
    it.signed_distance(torch.rand(10, 3), code).sum().backward()
    assert code.grad is not None
    assert code.grad.abs().max() > 0


def test_a_map_has_the_values_of_its_points() -> None:
    it, sphere = model(trained=True), UnitSphere((0.0, 0.0, 0.0), 2.0)
    grid = Grid((-1, -1.5, -1), (0.3, 0.4, 0.5), (7, 6, 5))
    field = it.signed_distance_map(grid, it.codes[0], sphere)
    assert torch.allclose(field.values, it.signed_distance(grid.points(), it.codes[0], sphere), atol=1e-6)


def test_bad_input_is_said() -> None:
    it = model()
    with pytest.raises(SDMError, match="the code has 5 numbers; this model's codes have 20"):
        it.signed_distance(torch.zeros(1, 3), torch.zeros(5))
    with pytest.raises(SDMError, match="2 of the points are not finite"):
        it.signed_distance([[0, 0, float("nan")], [0, 0, 0], [float("inf"), 0, 0]], it.codes[0])
    with pytest.raises(SDMError, match=r"the points have shape \(4, 2\)"):
        it.signed_distance(torch.zeros(4, 2), it.codes[0])
    with pytest.raises(SDMError, match="the code holds a number that is not finite"):
        it.signed_distance(torch.zeros(1, 3), torch.full((20,), float("nan")))
    with pytest.raises(SDMError, match="2 codes were given; signed_distance takes one"):
        it.signed_distance(torch.zeros(1, 3), it.codes)
