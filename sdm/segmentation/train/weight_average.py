"""The running mean of a network's weights, which generalises better than the last ones."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn


class Average:
    """Mean of weights over about the last `share` of the steps so far, whatever their number.

    After step t the newest weights count min(1, 1 / (share t)), so that weights of step s <= t count in proportion to
    s^(1 / share - 1): a power of time, as in T. Karras et al., "Analyzing and improving the training dynamics of
    diffusion models", CVPR 2024. With a share of 1 all steps count the same. The statistics of batch normalisation are
    averaged alike, as they belong to the weights.

    Args:
        model: The network.
        share: In 0..1, not 0.
    """

    def __init__(self, model: nn.Module, share: float) -> None:
        self.share = share
        self.values = [value.clone() for value in _tensors(model)]

    @torch.no_grad()
    def update(self, model: nn.Module, step: int) -> None:
        """Take in the weights after `step` steps, 1 or more."""
        newest = min(1.0, 1.0 / (self.share * step))
        get_ema_multi_avg_fn(1.0 - newest)(self.values, list(_tensors(model)), None)

    @torch.no_grad()
    def give(self, model: nn.Module) -> None:
        """Put the means into the network."""
        for value, mean in zip(_tensors(model), self.values, strict=True):
            value.copy_(mean)


def _tensors(model: nn.Module) -> Iterator[Tensor]:
    """Weights and statistics; whole numbers count steps and have no mean."""
    yield from (p.detach() for p in model.parameters())
    yield from (b for b in model.buffers() if b.is_floating_point())
