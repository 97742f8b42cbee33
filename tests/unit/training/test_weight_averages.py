"""Averages of weights."""

from __future__ import annotations

import pytest
import torch

from sdm.training.weight_averages import LateAverage, exponential_average


def test_weights_are_averaged():
    """Over all steps it is their mean; over a share of them, weights of step s of t count as s^(1 / share - 1)."""
    net = torch.nn.BatchNorm1d(1)
    whole, late = LateAverage(net, 1.0), LateAverage(net, 0.1)
    for step in range(1, 401):
        for name in ("weight", "running_var"):
            torch.nn.init.constant_(net.state_dict()[name], step)
        whole.update(net, step)
        late.update(net, step)
    for average, expected in ((late, 400 * 10 / 11), (whole, 200.5)):
        average.give(net)
        found = net.state_dict()
        assert found["weight"].item() == found["running_var"].item() == pytest.approx(expected, rel=0.01)
        assert found["num_batches_tracked"] == 0


def test_an_average_goes_on_from_what_was_kept():
    net, other = torch.nn.Linear(2, 1), torch.nn.Linear(2, 1)
    kept = LateAverage(net, 0.5)
    again = LateAverage(other, 0.5)
    again.restore(kept.values)
    assert all(torch.equal(a, b) for a, b in zip(again.values, kept.values, strict=True))
    with pytest.raises(ValueError, match="another network"):
        again.restore([torch.zeros(3)])
    with pytest.raises(ValueError, match="another network"):
        again.restore(kept.values[:1])


def test_an_exponential_average_forgets_at_its_rate():
    net = torch.nn.Linear(1, 1, bias=False)
    torch.nn.init.constant_(net.weight, 0.0)
    mean = exponential_average(net, 0.75)
    # The first update copies.
    mean.update_parameters(net)
    torch.nn.init.constant_(net.weight, 1.0)
    mean.update_parameters(net)
    assert mean.module.weight.item() == pytest.approx(0.25)
    mean.update_parameters(net)
    assert mean.module.weight.item() == pytest.approx(0.4375)
