"""Settings of a training of a surrogate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import nn

from sdm.core.random import derive_seed
from sdm.errors import FormatError, SDMError
from sdm.stream import Mixture, Sampler
from sdm.surrogate.infer.weights_file import load_weights
from sdm.surrogate.networks.models import build
from sdm.surrogate.networks.sdmnn_plus import SDMNNPlus
from sdm.surrogate.train.end_sampler import Ends
from sdm.surrogate.train.pointwise_start import with_pointwise
from sdm.training.budget import check_budget
from sdm.training.random_numbers import own_random_numbers
from sdm.training.training_settings import TrainingSettings, check_choice, check_counts, check_number

# Samples that a recipe streams; the paper's is the mixture of 625 static maps and random ones.
# In "mostly-online" the random ones are denser towards the faces and corners of the box, so as to be good there too;
# the 16 corners themselves, where a model has neighbours on one side only, are 3 of 100 samples.
RECIPES: dict[str, str | Sampler] = {
    "paper": "mixture:0.5",
    "static": "grid:5",
    "online": "uniform",
    "mostly-online": Mixture(Mixture("grid:2", "grid:5", 0.3), "chebyshev", 0.1),
    "ends": Ends(),
}
STATIC = 625


@dataclass(frozen=True, kw_only=True)
class Settings(TrainingSettings):
    """Everything that decides a training but the device.

    Args:
        model: "sdmnn" or "sdmnn-plus".
        modes: Modes of SDMNN+.
        channels: Feature maps of the network; by default its own.
        pointwise: Features of single blocks at the end of SDMNN+; 0: its first kind.
        recipe: "paper" (625 static maps and random ones, half each), "static" (the 625 alone), "online" (random
            ones alone), "mostly-online" (of the samples a tenth from the 625 and the box's 16 corners, the others
            by the sampler "chebyshev") or "ends" (random ones alone, see `Ends`).
        loss: "mse", or "surface" (absolute errors weighted to the surface, with the terms below).
        steps: Optimiser steps of the whole training.
        budget_s: Seconds of the whole training over all restarts; the schedule follows whichever is nearer its end.
        batch_size: Maps of a step.
        fresh: New maps made by the engine in each step; the others are drawn from the store of the latest. 0: the store
            is filled before the first step, and that is all.
        store: Maps kept on the device, 0.4 MB each.
        fill_share: Share of the budget in which the store is filled before the first step.
        warm_share: Share of the budget for the coefficients of SDMNN+ before the first step.
        rate: Largest learning rate.
        surface: Weight of the error at the surface, beside that of all voxels.
        dice: Weight of what is lost of the Dice coefficient, the root mean square over the shapes of a batch.
        flips: Weight of the voxels on the wrong side of the surface, as a share of those inside; likewise.
        hard: Share of a batch that is drawn among the maps that had most such voxels when they were last trained on.
        float32: Train in float32 on a GPU too, where bfloat16 is usual.
        coarse: Weight of the error of the coarse maps of SDMNN+, so that they are of use on their own.
        eikonal: Weight of | |grad f| - 1 |; loss "mse" leaves it out, and the next term.
        sobolev: Weight of the root of the squared error of d(map)/d(theta).
        sobolev_every: Steps between its uses, on 4 fresh shapes each.
        start: File of weights to go on from, in place of a beginning of its own; its sizes replace those given here.
            But if `pointwise` is given and it has none, it gets them, and keeps `modes` modes (`with_pointwise`).
        ema: Decay of the running mean of the weights, which is what is kept.
        seed: Of the stream and all else that is random.
    """

    LENGTH: ClassVar[tuple[str, ...]] = ("steps", "budget_s")

    model: str = "sdmnn-plus"
    modes: int = 208
    channels: int | None = None
    pointwise: int = 0
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
    dice: float = 0.0
    flips: float = 0.0
    hard: float = 0.0
    float32: bool = False
    coarse: float = 0.1
    eikonal: float = 0.01
    sobolev: float = 0.05
    sobolev_every: int = 16
    start: str | None = None
    ema: float = 0.998
    seed: int = 0

    def check(self) -> None:
        """Refuse settings that cannot be trained: see `TrainingSettings.check`."""
        if self.model not in ("sdmnn", "sdmnn-plus"):
            raise SDMError(f"{self.model!r} is not trained step by step; use sdmnn or sdmnn-plus")
        check_choice("recipe", self.recipe, RECIPES)
        check_choice("loss", self.loss, ("mse", "surface"))
        check_counts(
            **{name: getattr(self, name) for name in ("steps", "batch_size", "store", "modes", "sobolev_every")}
        )
        check_number("channels", self.channels, least=1)
        for name in ("fresh", "pointwise", "surface", "dice", "flips", "coarse", "eikonal", "sobolev"):
            check_number(name, getattr(self, name), least=0)
        check_number("learning rate", self.rate, least=0)
        for name in ("fill_share", "warm_share", "hard"):
            check_number(name, getattr(self, name), least=0, most=1)
        check_number("ema", self.ema, least=0, most=1)
        maps = STATIC if self.recipe == "static" else self.store
        if self.model == "sdmnn-plus" and self.start is None and self.modes >= maps:
            raise SDMError(f"{self.modes} modes need a store of more than {self.modes} maps, but it has {maps}")
        check_budget(self.budget_s)


def begin(settings: Settings) -> nn.Module:
    """The model of a training at its first step, on the host."""
    if settings.start is None:
        return build(settings.model, **_config(settings))
    model, facts = load_weights(Path(settings.start))
    if facts["model"] != settings.model:
        raise FormatError(f"{settings.start} holds {facts['model']}, not {settings.model}; name the model it holds")
    if settings.pointwise and isinstance(model, SDMNNPlus) and model.pointwise is None:
        with own_random_numbers():
            torch.manual_seed(derive_seed(settings.seed, "surrogate weights of single blocks"))
            model = with_pointwise(model, settings.modes, settings.pointwise)
    return model.train().requires_grad_()


def _config(settings: Settings) -> dict[str, Any]:
    channels = {} if settings.channels is None else {"channels": settings.channels}
    own = {"modes": settings.modes, "pointwise": settings.pointwise} if settings.model == "sdmnn-plus" else {}
    return channels | own
