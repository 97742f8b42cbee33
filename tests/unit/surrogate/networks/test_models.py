"""One interface: parameters to maps, differentiable, for any batch."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional

from sdm.errors import SDMError
from sdm.shapes import Cochlea
from sdm.surrogate import GRID, build
from sdm.surrogate.networks.sdmnn import SDMNN
from sdm.surrogate.networks.sdmnn_plus import SDMNNPlus
from sdm.surrogate.networks.voxel_shuffle import merge, split

SMALL = {
    "sdmnn": {"channels": 2},
    "sdmnn-plus": {"modes": 3, "channels": 4},
    "pod-chebyshev": {"modes": 3, "degree": 2},
}


def small(name: str) -> torch.nn.Module:
    torch.manual_seed(0)
    model = build(name, **SMALL[name])
    if name == "pod-chebyshev":
        model.weights.normal_()
        model.modes.normal_()
    if name == "sdmnn-plus":
        torch.nn.init.normal_(model.last.weight)
        torch.nn.init.normal_(model.film.weight, std=0.1)
    return model


@pytest.mark.parametrize("name", SMALL)
def test_a_batch_is_its_samples(name):
    model, theta = small(name), Cochlea().sample(2, seed=3, device="cpu")
    with torch.no_grad():
        both = model(theta)
        assert both.shape == (2, 1, *GRID.shape)
        assert both.dtype == torch.float32
        for row in range(2):
            torch.testing.assert_close(model(theta[row : row + 1])[0], both[row], atol=1e-4, rtol=1e-4)
        assert (both[0] - both[1]).abs().max() > 1e-3


@pytest.mark.parametrize("pointwise", [0, 3])
def test_the_maps_in_training_are_those_of_the_network(pointwise, monkeypatch):
    monkeypatch.setitem(SMALL["sdmnn-plus"], "pointwise", pointwise)
    model, theta = small("sdmnn-plus"), Cochlea().sample(2, seed=4, device="cpu")
    if model.interpolate is not None:
        torch.nn.init.normal_(model.interpolate.weight, std=0.1)
    torch.nn.init.normal_(model.mean)
    with torch.no_grad():
        coarse, maps = model.both(theta)
        torch.testing.assert_close(maps, model(theta), atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(merge(coarse, 2), model.coarse(theta))


@pytest.mark.parametrize("name", SMALL)
def test_the_derivative_by_theta_is_that_of_the_map(name):
    # The networks have kinks (pooling, activations): steps are small enough to cross few, in double precision.
    model = small(name).double()
    model.features.double()
    weights = torch.randn(GRID.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    theta = torch.tensor([[3.5, 0.5, 0.14, 0.2]], dtype=torch.float64, requires_grad=True)

    def value(at):
        return (model(at)[0, 0] * weights).sum()

    (slope,) = torch.autograd.grad(value(theta), theta)
    assert slope.abs().min() > 0
    for column in range(4):
        step = torch.zeros_like(theta)
        step[0, column] = 1e-8
        with torch.no_grad():
            difference = (value(theta + step) - value(theta - step)) / 2e-8
        assert float(difference) == pytest.approx(float(slope[0, column]), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("pointwise", [0, 3])
def test_the_refinement_begins_as_trilinear_interpolation(pointwise):
    model = SDMNNPlus(modes=2, channels=2, pointwise=pointwise)
    coarse = torch.randn(1, 1, 40, 32, 20)
    around = functional.pad(split(coarse, 2), (1,) * 6, mode="replicate")
    wanted = functional.interpolate(coarse, scale_factor=2, mode="trilinear")
    inner = (..., slice(1, -1), slice(1, -1), slice(1, -1))
    # The outermost layer lies beyond the coarse values, where the two continue in different ways.
    torch.testing.assert_close(merge(model.interpolated_blocks(around), 4)[inner], wanted[inner], atol=1e-5, rtol=1e-5)


def test_blocks_are_taken_apart_and_put_together():
    maps = torch.arange(2 * 8 * 4 * 12.0).reshape(2, 1, 8, 4, 12)
    parts = split(maps, 4)
    assert parts.shape == (2, 64, 2, 1, 3)
    assert torch.equal(parts[1, :, 1, 0, 2], maps[1, 0, 4:8, 0:4, 8:12].reshape(-1))
    assert torch.equal(merge(parts, 4), maps)


def test_an_unknown_model_is_refused():
    with pytest.raises(SDMError, match="sdmnn-plus"):
        build("sdmnn++")


@pytest.mark.parametrize("channels", [0, 1, 5, 10, 20])
def test_channels_that_cannot_be_normalised_in_groups(channels):
    with pytest.raises(SDMError, match=f"a multiple of 8 channels, not {channels}"):
        SDMNN(channels)


@pytest.mark.parametrize("channels", [2, 3, 12, 24])
def test_channels_that_can(channels):
    with torch.no_grad():
        assert build("sdmnn", channels=channels)(Cochlea().sample(1, device="cpu")).shape == (1, 1, *GRID.shape)
