"""What it means for rates and weights how far a training is."""

from __future__ import annotations

import math

from sdm.deepsdf.train.settings import Settings

# Share of a cosine schedule in which the rate rises, and where it ends.
RISE = 0.02
END = 0.01


def rate_factor(settings: Settings, done: float) -> float:
    """What the learning rates are multiplied by when a share `done` of the training is over."""
    if settings.schedule == "halving":
        return 0.5 ** int(4 * done)
    return min(1.0, (done + 1e-3) / RISE) * (END + (1 - END) * (1 + math.cos(math.pi * done)) / 2)


def code_weight(settings: Settings, done: float) -> float:
    """Weight of the codes' squared lengths when a share `done` of the training is over."""
    return settings.code_weight * (min(1.0, done / settings.code_rise) if settings.code_rise > 0 else 1.0)
