"""What a training of a surrogate depends on."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from torch import nn

from sdm.errors import FormatError, SDMError
from sdm.stream import Mixture, Sampler
from sdm.surrogate.infer.weights_file import load_weights
from sdm.surrogate.networks.models import build
from sdm.training.budget import check_budget

# Which samples a recipe streams; the paper's is the mixture of 625 static maps and random ones.
# In "mostly-online" the random ones are denser towards the faces and corners of the box, so as to be good there too;
# the 16 corners themselves, where a model has neighbours on one side only, are 3 of 100 samples.
RECIPES: dict[str, str | Sampler] = {
    "paper": "mixture:0.5",
    "static": "grid:5",
    "online": "uniform",
    "mostly-online": Mixture(Mixture("grid:2", "grid:5", 0.3), "chebyshev", 0.1),
}
STATIC = 625


@dataclass(frozen=True)
class Settings:
    """What a training depends on, besides the device.

    Args:
        model: "sdmnn" or "sdmnn-plus".
        modes: Modes of SDMNN+.
        channels: Feature maps of the network; by default its own.
        recipe: "paper" (625 static maps and random ones, half each), "static" (the 625 alone), "online" (random
            ones alone) or "mostly-online" (of the samples a tenth from the 625 and the box's 16 corners, the others
            by the sampler "chebyshev").
        loss: "mse", or "surface" (absolute errors weighted to the surface, with the terms below).
        steps: Optimiser steps of the whole training.
        budget_s: Seconds of the whole training over all restarts; the schedule follows whichever is nearer its end.
        batch_size: Maps of a step.
        fresh: New maps made by the engine in each step; the others are drawn from the store of the latest.
        store: Maps kept on the device, 0.4 MB each.
        fill_share: Share of the budget in which the store is filled before the first step.
        warm_share: Share of the budget for the coefficients of SDMNN+ before the first step.
        rate: Largest learning rate.
        surface: Weight of the error at the surface, beside that of all voxels.
        coarse: Weight of the error of the coarse maps of SDMNN+, so that they are of use on their own.
        eikonal: Weight of | |grad f| - 1 |; loss "mse" leaves it out, and the next term.
        sobolev: Weight of the root of the squared error of d(map)/d(theta).
        sobolev_every: Steps between its uses, on 4 fresh shapes each.
        start: File of weights to go on from, in place of a beginning of its own; its sizes replace those given here.
        ema: Decay of the running mean of the weights, which is what is kept.
        seed: Of the stream and all else that is random.
    """

    model: str = "sdmnn-plus"
    modes: int = 208
    channels: int | None = None
    recipe: str = "mostly-online"
    loss: str = "surface"
    steps: int = 100_000
    budget_s: float | None = None
    batch_size: int = 32
    fresh: int = 4
    store: int = 16_384
    fill_share: float = 0.25
    warm_share: float = 0.2
    rate: float = 1e-3
    surface: float = 1.0
    coarse: float = 0.1
    eikonal: float = 0.01
    sobolev: float = 0.05
    sobolev_every: int = 16
    start: str | None = None
    ema: float = 0.998
    seed: int = 0

    def __post_init__(self) -> None:
        if self.model not in ("sdmnn", "sdmnn-plus"):
            raise SDMError(f"{self.model!r} is not trained step by step; use sdmnn or sdmnn-plus")
        if self.recipe not in RECIPES:
            raise SDMError(f"there is no recipe {self.recipe!r}; use {', '.join(RECIPES)}")
        if self.loss not in ("mse", "surface"):
            raise SDMError(f"there is no loss {self.loss!r}; use mse or surface")
        if min(self.steps, self.batch_size, self.store) < 1 or self.fresh < 0:
            raise SDMError("steps, batch size and store are at least 1, fresh maps at least 0")
        if min(self.modes, 1 if self.channels is None else self.channels) < 1:
            raise SDMError("modes and channels are at least 1")
        for name in ("fill_share", "warm_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise SDMError(f"{name} is {getattr(self, name)}; a share from 0 to 1 is needed")
        for name in ("rate", "surface", "coarse", "eikonal", "sobolev"):
            if not 0 <= getattr(self, name) < math.inf:
                raise SDMError(f"{name} is {getattr(self, name)}; a number of 0 or more is needed")
        maps = STATIC if self.recipe == "static" else self.store
        if self.model == "sdmnn-plus" and self.start is None and self.modes >= maps:
            raise SDMError(f"{self.modes} modes need a store of more than {self.modes} maps, but it has {maps}")
        check_budget(self.budget_s)


def identity(settings: Settings) -> dict[str, Any]:
    """The settings that cannot change half-way: all but how long it takes."""
    return {k: v for k, v in asdict(settings).items() if k not in ("steps", "budget_s")}


def begin(settings: Settings) -> nn.Module:
    """The model of a training at its first step, on the host."""
    if settings.start is None:
        return build(settings.model, **_config(settings))
    model, facts = load_weights(Path(settings.start))
    if facts["model"] != settings.model:
        raise FormatError(f"{settings.start} holds {facts['model']}, not {settings.model}; name the model it holds")
    return model.train().requires_grad_()


def _config(settings: Settings) -> dict[str, Any]:
    channels = {} if settings.channels is None else {"channels": settings.channels}
    return channels | ({"modes": settings.modes} if settings.model == "sdmnn-plus" else {})
