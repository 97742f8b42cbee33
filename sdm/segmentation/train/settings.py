"""Settings of a training of a segmentation network."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from sdm.core.device import plain_defaults
from sdm.core.given_values import whole
from sdm.errors import SDMError
from sdm.segmentation.data.augment import Augment
from sdm.segmentation.networks.model import NETWORKS, Architecture, SegmentationModel
from sdm.segmentation.train.methods import METHODS, method_called
from sdm.training.schedules import cosine_decay
from sdm.training.training_settings import TrainingSettings, check_choice, check_number


@dataclass(frozen=True, kw_only=True)
class Settings(TrainingSettings):
    """One training; the same for every method of a table but for the method's name.

    Args:
        method: One of `METHODS`.
        architecture: "vnet" or "unet".
        patch: Voxels of a patch, multiples of 16 (vnet) or 8 (unet).
        coarsen: The network sees voxels so many times as large along each axis, and with the same patch so much more
            of the body; a patch counts these larger voxels. What it says is enlarged linearly.
        batch: Patches a step.
        steps: Steps of the optimiser.
        optimizer: "adam" (AdamW) or "sgd" (Nesterov momentum 0.9). Its learning rate rises over the first 5 % of the
            steps.
        learning_rate: Highest.
        schedule: The learning rate after that falls to zero along a "cosine", or stays ("constant").
        weight_decay: Decoupled with adam, L2 with sgd.
        average: Share of the training, up to its end, over which the weights are averaged: see `LateAverage`; 0: the
            last ones.
        augment: "none", "published", "affine", "strong" or "scanner": see `augment.draw`.
        mirrors: Along which of the axes "xyz" patches are mirrored at random. Mirror images are more to learn from, but
            hide on which side a neighbouring organ lies.
        targets: Distance maps of the whole "case", or of the "patch" as published.
        filters: Of the network's finest level; None: the paper's.
        dropout: Of the coarsest level; None: the paper's.
        last_dropout: Of what the main output is made of: 0.5 in Ma's public code.
        position: Whether the network is told where each voxel is in its volume: see `positions`. It relies on volumes
            that show about the same part of the body.
        synthetic: Share of the patches that are of synthetic cases, see `SyntheticPatches`; 0 for none.
        seed: Of weights, patches and dropout.
    """

    method: str = "baseline"
    architecture: Architecture = "vnet"
    patch: tuple[int, int, int] = (112, 112, 80)
    coarsen: int = 1
    batch: int = 4
    steps: int = 2000
    optimizer: Literal["adam", "sgd"] = "adam"
    learning_rate: float = 1e-3
    schedule: Literal["cosine", "constant"] = "cosine"
    weight_decay: float = 1e-4
    average: float = 0.0
    augment: Augment = "affine"
    mirrors: str = "xyz"
    targets: Literal["case", "patch"] = "case"
    filters: int | None = None
    dropout: float | None = None
    last_dropout: float = 0.0
    position: bool = False
    synthetic: float = 0.0
    seed: int = 0

    def check(self) -> None:
        """Refuse settings that cannot be trained: see `TrainingSettings.check`."""
        method_called(self.method)
        check_choice("network", self.architecture, NETWORKS)
        multiple = NETWORKS[self.architecture][2]
        sizes = [whole(n, multiple) for n in self.patch] if isinstance(self.patch, list | tuple) else []
        if len(sizes) != 3 or any(n is None or n % multiple for n in sizes):
            raise SDMError(f"a patch of {self.patch!r} does not suit {self.architecture}: use multiples of {multiple}")
        if whole(self.coarsen, 1) is None:
            raise SDMError(f"voxels are made larger by a whole number, 1 or more, not by {self.coarsen!r}")
        if whole(self.batch, 1) is None or whole(self.steps, 1) is None:
            raise SDMError(f"{self.steps!r} steps of {self.batch!r} patches train nothing: give at least one of each")
        if self.batch * math.prod(n // multiple for n in self.patch) < 2:
            raise SDMError("one patch of one coarsest voxel cannot be normalised: use a larger patch or batch")
        check_number("the learning rate", self.learning_rate, above=0)
        if not isinstance(self.mirrors, str) or not set(self.mirrors) <= set("xyz"):
            raise SDMError(f"patches are mirrored along axes of xyz, not along {self.mirrors!r}")
        check_number("the averaged share of the training", self.average, least=0, most=1)
        # The first of the U-Net's convolutions has half of the filters.
        check_number("filters", self.filters, least=2 if self.architecture == "unet" else 1)
        check_number("dropout", self.dropout, least=0, below=1)
        check_number("last_dropout", self.last_dropout, least=0, below=1)
        check_number("the share of synthetic patches", self.synthetic, least=0, most=1)

    @property
    def mirrored(self) -> str:
        """The axes along which patches were mirrored: `mirrors` is for augmentations that turn freely alone."""
        return {"none": "", "published": "xy"}.get(self.augment, self.mirrors)

    def learning_rate_at(self, step: int) -> float:
        """The learning rate of a step."""
        warm = max(1, self.steps // 20)
        if step < warm:
            return self.learning_rate * (step + 1) / warm
        if self.schedule == "constant":
            return self.learning_rate
        return self.learning_rate * cosine_decay(step - warm, max(1, self.steps - warm))

    def network(self) -> SegmentationModel:
        """The network, not trained, float32 on the host."""
        with plain_defaults():
            return SegmentationModel(
                METHODS[self.method],
                self.architecture,
                filters=self.filters,
                dropout=self.dropout,
                last_dropout=self.last_dropout,
                position=self.position,
                coarsen=self.coarsen,
            )
