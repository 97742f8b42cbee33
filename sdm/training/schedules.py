"""Schedules: learning rates and weights of losses as pure functions of the step, the same after a restart.

A `Schedule` of weights mixes two losses as `w = schedule(step); w * region + (1 - w) * boundary`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from sdm.core.given_values import real
from sdm.errors import SDMError

Schedule = Callable[[float], float]


def cosine_decay(done: float, whole: float = 1.0, floor: float = 0.0) -> float:
    """Factor of a learning rate along half a cosine, from 1 at 0 to `floor` at `whole`.

    I. Loshchilov, F. Hutter, "SGDR: Stochastic gradient descent with warm restarts", ICLR 2017.
    """
    return floor + (1 - floor) * (0.5 * (1 + math.cos(math.pi * done / whole)))


def linear_warmup(done: float, whole: float) -> float:
    """Factor that rises from 0 at 0 in a straight line to 1 at `whole` and stays there; 1 if `whole` is 0."""
    return min(1.0, done / whole) if whole > 0 else 1.0


def warmup_cosine(share: float, warmup: float = 0.02, floor: float = 0.005) -> float:
    """Factor of a learning rate: `linear_warmup`, not below `floor`, then `cosine_decay` over what is left."""
    if share < warmup:
        return max(linear_warmup(share, warmup), floor)
    return cosine_decay(share - warmup, 1 - warmup, floor)


def constant(weight: float) -> Schedule:
    """The same weight at every step.

    Raises:
        SDMError: The weight is no number.
    """
    _check_numbers(weight)
    return lambda step: weight


def linear(first: float, last: float, steps: float) -> Schedule:
    """Weight from `first` at step 0 in a straight line to `last` at `steps`, and `last` from there on.

    Raises:
        SDMError: A weight that is no number, or steps that are not positive.
    """
    _check_numbers(first, last)
    _check(steps)
    return lambda step: first + (last - first) * min(max(step / steps, 0.0), 1.0)


def stepwise(first: float, change: float, every: float, last: float) -> Schedule:
    """Weight `first`, changed by `change` after every `every` steps, until it is `last`.

    `stepwise(1.0, -0.01, steps_per_epoch, 0.01)` is the rebalancing of Kervadec et al. (boundary loss, 2019), which
    Ma's study uses for the boundary and the Hausdorff losses: the region loss's weight falls by 0.01 an epoch.

    Raises:
        SDMError: The weight never gets to `last`, or the steps are not positive.
    """
    _check_numbers(first, change, last)
    _check(every)
    if change == 0 or (last - first) * change < 0:
        raise SDMError(f"a weight that begins at {first} and changes by {change} never gets to {last}")
    least, most = min(first, last), max(first, last)
    return lambda step: min(max(first + change * math.floor(max(step, 0.0) / every), least), most)


def sigmoid_rampup(last: float, steps: float) -> Schedule:
    """Weight last * exp(-5 (1 - t)^2), t = step / steps up to 1 (S. Laine, T. Aila, "Temporal ensembling", 2017).

    Raises:
        SDMError: A weight that is no number, or steps that are not positive.
    """
    _check_numbers(last)
    _check(steps)
    return lambda step: last * math.exp(-5.0 * (1.0 - min(max(step / steps, 0.0), 1.0)) ** 2)


def _check(steps: float) -> None:
    if not real(steps) > 0:
        raise SDMError(f"a schedule needs a positive number of steps, not {steps!r}")


def _check_numbers(*weights: float) -> None:
    for weight in weights:
        if math.isnan(real(weight)):
            raise SDMError(f"a weight of a schedule is {weight!r}; give a number")
