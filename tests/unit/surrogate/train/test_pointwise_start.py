"""A network gets features of single blocks and gives the same maps, less what it cannot keep."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import SDMError
from sdm.shapes import Cochlea
from sdm.surrogate import SDMNNPlus, Settings, save_weights
from sdm.surrogate.train.pointwise_start import with_pointwise
from sdm.surrogate.train.settings import begin


def network() -> SDMNNPlus:
    """As it begins but for its last layer, which takes all others' outputs."""
    torch.manual_seed(0)
    model = SDMNNPlus(modes=6, hidden=8, channels=4)
    torch.nn.init.normal_(model.last.weight, std=0.1)
    torch.nn.init.normal_(model.film.weight, std=0.1)
    return model


@torch.no_grad()
def test_maps_are_the_same_until_it_is_trained():
    model, theta = network(), Cochlea().sample(2, seed=1, device="cpu")
    torch.testing.assert_close(with_pointwise(model, 6, 3)(theta), model(theta), atol=1e-5, rtol=1e-5)
    model.modes[4:] = 0
    fewer = with_pointwise(model, 4, 3)
    assert fewer.config["modes"] == 4
    torch.testing.assert_close(fewer(theta), model(theta), atol=1e-5, rtol=1e-5)


def test_more_modes_than_there_are_are_refused():
    with pytest.raises(SDMError, match="7 modes of a network that has 6"):
        with_pointwise(network(), 7, 3)


def test_a_training_begins_with_it(tmp_path):
    file, theta = tmp_path / "a.safetensors", Cochlea().sample(1, seed=1, device="cpu")
    save_weights(network(), file)
    first, second = (begin(Settings(start=str(file), modes=5, pointwise=3)) for _ in range(2))
    assert first.config == {"modes": 5, "hidden": 8, "channels": 4, "depth": 1, "pointwise": 3}
    assert torch.equal(first(theta), second(theta))
    save_weights(first, file)
    # It has such features: its own sizes stay.
    assert begin(Settings(start=str(file), modes=4, pointwise=2)).config == first.config
    assert "pointwise" not in begin(Settings(modes=4, channels=4)).config
