"""Averages of a network's weights over the training, which generalise better than the last ones."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn


def exponential_average(model: nn.Module, decay: float) -> AveragedModel:
    """Exponential moving average of a network's weights: after each step the newest count 1 - `decay`.

    A copy of the network that `update_parameters(model)` moves; its buffers stay those of the beginning.
    """
    return AveragedModel(model, multi_avg_fn=get_ema_multi_avg_fn(decay), use_buffers=False)


class LateAverage:
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
        _copy(self.values, list(_tensors(model)))

    @torch.no_grad()
    def restore(self, values: list[Tensor]) -> None:
        """Take the means of a checkpoint.

        Raises:
            ValueError: They are of another network.
        """
        _copy(values, self.values)


def _copy(values: list[Tensor], targets: list[Tensor]) -> None:
    if [value.shape for value in values] != [target.shape for target in targets]:
        raise ValueError("the averages are those of another network")
    for value, target in zip(values, targets, strict=True):
        target.copy_(value)


def _tensors(model: nn.Module) -> Iterator[Tensor]:
    """Weights and statistics; whole numbers count steps and have no mean."""
    yield from (p.detach() for p in model.parameters())
    yield from (b for b in model.buffers() if b.is_floating_point())
