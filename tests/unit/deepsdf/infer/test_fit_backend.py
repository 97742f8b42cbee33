"""A DeepSDF as the backend of a fit: derivatives by size, code and points against differences, and the box of codes."""

from __future__ import annotations

import pytest
import torch

from sdm.deepsdf import DeepSDF, local, published
from sdm.deepsdf.infer.fit_backend import DeepSDFBackend, factor_of_model
from sdm.deepsdf.networks.auto_decoder import AutoDecoder
from sdm.deepsdf.samples import UnitSphere
from sdm.errors import SDMError


def model_of(settings, count: int = 5) -> DeepSDF:
    torch.manual_seed(0)
    whole = AutoDecoder(settings, count)
    with torch.no_grad():
        for weight in whole.decoder.last.parameters():
            weight.normal_(0, 0.1)
    spheres = [UnitSphere((1.0, 2.0, 3.0), 20.0 + k) for k in range(count)]
    return DeepSDF(settings, whole.decoder, whole.bounded_codes(), [str(k) for k in range(count)], spheres)


SMALL = [
    local(width=16, global_size=8, grids=((4, 2),)),
    local(width=16, global_size=8, grids=()),
    published(width=32, global_size=8, dropout=0.0),
]


@pytest.mark.parametrize("settings", SMALL, ids=lambda s: s.variant)
def test_derivatives_are_those_of_differences(settings) -> None:
    model = model_of(settings)
    backend = DeepSDFBackend(model, factor_of_model(model))
    assert factor_of_model(model) == pytest.approx(5 / 22)
    assert [p.name for p in backend.parameters] == ["size", "code1", "code2", "code3", "code4"]
    assert (backend.parameters[0].low, backend.parameters[0].high) == (16.0, 30.0)
    theta = torch.tensor([21.0, 0.5, -1.0, 0.2, 1.5], dtype=torch.float64)
    points = 3 * torch.randn(50, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = backend.with_derivatives(theta, points)
    torch.testing.assert_close(found.values, backend.distances(theta, points), atol=1e-5, rtol=0)
    for k in range(len(theta)):
        step = torch.zeros_like(theta)
        step[k] = 0.05
        change = backend.distances(theta + step, points) - backend.distances(theta - step, points)
        torch.testing.assert_close(found.by_theta[:, k], change / 0.1, atol=2e-3, rtol=2e-2)
    for axis in range(3):
        step = 0.01 * torch.eye(3, dtype=torch.float64)[axis]
        change = backend.distances(theta, points + step) - backend.distances(theta, points - step)
        near = (found.by_point[:, axis] - change / 0.02).abs() < 0.02
        # Where a ReLU bends between the two, a difference is neither slope.
        assert float(near.double().mean()) > 0.9


def test_the_codes_of_training_shapes_are_in_the_box() -> None:
    model = model_of(SMALL[0])
    backend = DeepSDFBackend(model)
    away = model.codes.double() - model.codes.double().mean(0)
    theta = away @ torch.linalg.pinv(backend._modes)
    assert float(theta.abs().max()) < 3
    own = torch.cat([torch.tensor([20.0], dtype=torch.float64), theta[2]])
    torch.testing.assert_close(backend.code(own), model.codes[2], atol=1e-4, rtol=1e-3)


def test_a_model_of_one_shape_is_refused() -> None:
    with pytest.raises(SDMError, match="trained on one shape"):
        DeepSDFBackend(model_of(SMALL[0], count=1))
