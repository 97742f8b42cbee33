"""The network laid out for plain torch on a CPU gives the network's own maps."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch

from sdm.shapes import Cochlea
from sdm.surrogate import GRID, SDMNNPlus
from sdm.surrogate.infer.folded import FoldedNetwork
from sdm.surrogate.infer.weights_file import FINE_ROWS, WHOLE


def network(modes: int, depth: int = 1, pointwise: int = 0) -> SDMNNPlus:
    """With no weight at its beginning, and maps of the size of millimetres."""
    torch.manual_seed(0)
    model = SDMNNPlus(modes=modes, hidden=8, channels=4, depth=depth, pointwise=pointwise).eval().requires_grad_(False)
    model.mean.add_(3 * torch.randn_like(model.mean))
    for layer, size in ((model.interpolate, 0.002), (model.last, 0.02), (model.film, 0.2)):
        if layer is not None:
            layer.weight.add_(size * torch.randn_like(layer.weight))
    if model.interpolate is not None:
        for bias in (model.interpolate.bias, model.last.bias):
            assert bias is not None
            bias.add_(0.01 * torch.randn_like(bias))
    model.place.add_(0.1 * torch.randn_like(model.place))
    return model


def eight_bit(model: SDMNNPlus) -> SDMNNPlus:
    """With modes as a file has them, the small ones a tenth of the others."""
    small = model.modes[FINE_ROWS:] / 10
    scale = small.abs().amax(1, keepdim=True) / WHOLE
    model.modes[FINE_ROWS:] = (small / scale).round() * scale
    return model


@pytest.mark.parametrize(
    ("modes", "depth", "pointwise"), [(5, 1, 0), (30, 2, 0), (5, 0, 0), (5, 1, 6), (5, 2, 3), (5, 0, 4)]
)
def test_float32_is_the_network_up_to_rounding(modes, depth, pointwise):
    model = network(modes, depth, pointwise)
    run = FoldedNetwork(model, torch.float32)
    theta = Cochlea().sample(3, seed=1, device="cpu")
    for rows in (theta, theta[1:2]):
        maps = run(rows)
        assert maps.shape == (len(rows), 1, *GRID.shape)
        assert maps.dtype == torch.float32
        torch.testing.assert_close(maps, model(rows), atol=3e-5, rtol=1e-5)
    assert all(not torch.equal(a, b) for a, b in pairwise(run(theta)))


@pytest.mark.parametrize("pointwise", [0, 6])
@pytest.mark.parametrize("kind", ["whole", "float", "without"])
def test_bfloat16_is_close_whatever_the_modes_are(kind, pointwise, monkeypatch):
    model = network(FINE_ROWS + 9, pointwise=pointwise)
    if kind != "float":
        model = eight_bit(model)
    if kind == "without":
        monkeypatch.delattr(torch, "_weight_int8pack_mm", raising=False)
    run = FoldedNetwork(model, torch.bfloat16)
    if kind != "whole":
        assert run._modes._small is None
    theta = Cochlea().sample(2, seed=1, device="cpu")
    error = (run(theta) - model(theta)).abs()
    assert float(error.max()) < 0.03
    assert float(error.mean()) < 0.002


def test_a_product_that_is_wrong_is_not_used(monkeypatch):
    def wrong(x, packed, scale):
        return x.new_full((len(x), len(packed)), float("nan"))

    monkeypatch.setattr(torch, "_weight_int8pack_mm", wrong, raising=False)
    model = eight_bit(network(FINE_ROWS + 9))
    run = FoldedNetwork(model, torch.bfloat16)
    assert run._modes._small is None
    theta = Cochlea().sample(1, seed=1, device="cpu")
    assert float((run(theta) - model(theta)).abs().max()) < 0.03


def test_later_changes_of_the_weights_have_no_effect():
    model = network(5)
    run, theta = FoldedNetwork(model, torch.float32), Cochlea().sample(1, seed=1, device="cpu")
    before = run(theta)
    for weight in model.parameters():
        weight.zero_()
    assert torch.equal(run(theta), before)


def test_threads_of_torch_are_as_before():
    before = torch.get_num_threads()
    run = FoldedNetwork(network(5), torch.bfloat16)
    run(Cochlea().sample(1, seed=1, device="cpu"))
    assert torch.get_num_threads() == before
