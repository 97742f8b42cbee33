"""Objective of each method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from sdm.losses import (
    boundary_loss,
    cross_entropy_loss,
    dice_loss,
    hausdorff_distance_loss,
    inverse_weighted_mse_loss,
    linear,
    sdf_product_loss,
)
from sdm.segmentation.networks.model import probability
from sdm.segmentation.train.methods import Method

# The region loss keeps this share at the end of the schedule.
LAST_SHARE = 0.01
PRODUCT_WEIGHT = 10.0


@dataclass(frozen=True)
class Step:
    """Step of a training as its loss sees it: outputs and targets (B,1,x,y,z), and how far training is, 0 to 1."""

    method: Method
    main: Tensor
    label: Tensor
    map: Tensor | None
    done: float
    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)


def _map(step: Step) -> Tensor:
    if step.map is None:
        raise ValueError(f"{step.method.name} has no distance map")
    return step.map


def _region(step: Step) -> Tensor:
    """(cross-entropy + Dice) / 2, Ma's baseline."""
    dice = dice_loss(probability(step.main, step.method), step.label)
    return 0.5 * (cross_entropy_loss(step.main, step.label) + dice)


def _rebalanced(step: Step, other: Tensor) -> Tensor:
    """alpha (cross-entropy + Dice) + (1 - alpha) other, alpha from 1 to 0.01 over the training."""
    alpha = linear(1.0, LAST_SHARE, 1.0)(step.done)
    return alpha * 2.0 * _region(step) + (1.0 - alpha) * other


def _boundary(step: Step) -> Tensor:
    return _rebalanced(step, boundary_loss(probability(step.main, step.method), step.label, distance=_map(step)))


def _hausdorff(step: Step, *, foreground_only: bool = False) -> Tensor:
    """Ma's mean[(p - g)^2 (d_s^2 + d_g^2)]; both transforms are taken anew at every step."""
    chance = probability(step.main, step.method)
    other = hausdorff_distance_loss(chance, step.label, step.spacing, foreground_only=foreground_only)
    return _rebalanced(step, other)


def _product(step: Step) -> Tensor:
    """Dice(sigmoid(-1500 phi)) + 10 (product + L1)."""
    dice = dice_loss(probability(step.main, step.method), step.label)
    return dice + PRODUCT_WEIGHT * sdf_product_loss(step.main, _map(step))


LOSSES: dict[str, Callable[[Step], Tensor]] = {
    "region": _region,
    "cross-entropy": lambda step: cross_entropy_loss(step.main, step.label),
    "boundary": _boundary,
    "hausdorff": _hausdorff,
    "hausdorff-foreground": lambda step: _hausdorff(step, foreground_only=True),
    "product": _product,
    "weighted-mse": lambda step: inverse_weighted_mse_loss(step.main, _map(step)),
}


def objective(step: Step, auxiliary: Tensor | None) -> Tensor:
    """The loss of one step, a scalar.

    With an auxiliary output it is cross-entropy + Dice + the distance's loss (Ma et al., MIDL 2020).
    """
    if auxiliary is None:
        return LOSSES[step.method.loss](step)
    error = auxiliary - _map(step)
    distance = step.method.distance or ""
    loss = 2.0 * _region(step)
    if "l1" in distance:
        loss = loss + error.abs().mean()
    if "l2" in distance:
        loss = loss + error.square().mean()
    return loss
