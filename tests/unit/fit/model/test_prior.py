"""The prior keeps to the device of what it is given."""

from __future__ import annotations

import torch

from sdm.fit import State
from sdm.fit.model.prior import Prior
from sdm.shapes import Cochlea


def test_steps_stay_on_their_device() -> None:
    """On the device without numbers a tensor of another device is refused as a GPU refuses it."""
    state = State(*(torch.zeros(size, dtype=torch.float64, device="meta") for size in ((4,), (3, 3), (3,), (3,))))
    prior = Prior.of(Cochlea(2_000).parameters, state)
    step = torch.zeros(10, dtype=torch.float64, device="meta")
    assert prior.precision.device.type == "meta"
    assert prior.blocked(state, step).device.type == "meta"
    assert prior.clip(state, step).device.type == "meta"


def test_a_step_is_cut_as_a_whole() -> None:
    zero, one = torch.zeros(4, dtype=torch.float64), torch.ones(4, dtype=torch.float64)
    state = State(one / 2, torch.eye(3, dtype=torch.float64), zero[:3], zero[:3])
    prior = Prior(zero, one, state)
    step = torch.tensor([0.5, 0, 0, 0, 0, 0, 0.2, 0, 0, 1.0], dtype=torch.float64)
    assert torch.allclose(prior.clip(state, step), step / 2)
