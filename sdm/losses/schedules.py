"""Weights of losses as functions of the step: pure, so that a run that resumes goes on where it was.

Mix two losses as `w = schedule(step); w * region + (1 - w) * boundary`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from sdm.errors import SDMError

Schedule = Callable[[float], float]


def constant(weight: float) -> Schedule:
    """The same weight at every step."""
    return lambda step: weight


def linear(first: float, last: float, steps: float) -> Schedule:
    """From `first` at step 0 in a straight line to `last` at `steps`, and `last` from there on."""
    _check(steps)
    return lambda step: first + (last - first) * min(max(step / steps, 0.0), 1.0)


def stepwise(first: float, change: float, every: float, last: float) -> Schedule:
    """`first`, changed by `change` after every `every` steps, until it is `last`.

    `stepwise(1.0, -0.01, steps_per_epoch, 0.01)` is the rebalancing of Kervadec et al. (boundary loss, 2019), which
    Ma's study uses for the boundary and the Hausdorff losses: the region loss's weight falls by 0.01 an epoch.
    """
    _check(every)
    if change == 0 or (last - first) * change < 0:
        raise SDMError(f"a weight that begins at {first} and changes by {change} never gets to {last}")
    least, most = min(first, last), max(first, last)
    return lambda step: min(max(first + change * math.floor(max(step, 0.0) / every), least), most)


def sigmoid_rampup(last: float, steps: float) -> Schedule:
    """last * exp(-5 (1 - t)^2), t = step / steps up to 1: S. Laine, T. Aila, "Temporal ensembling", ICLR 2017."""
    _check(steps)
    return lambda step: last * math.exp(-5.0 * (1.0 - min(max(step / steps, 0.0), 1.0)) ** 2)


def _check(steps: float) -> None:
    if not steps > 0:
        raise SDMError(f"a schedule needs a positive number of steps, not {steps}")
