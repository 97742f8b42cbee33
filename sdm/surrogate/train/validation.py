"""The fixed validation set: 1,000 shapes, the corners of the box among them."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator

import torch
from torch import Tensor

from sdm.core.random import derive_seed
from sdm.shapes import Family, make_family
from sdm.stream import Batch, Maker
from sdm.stream.held_out_samples import held_out_samples
from sdm.stream.sample_maker import grid_record
from sdm.stream.samplers import Table
from sdm.surrogate.networks.cochlea_grid import GRID

COUNT = 1000
SEED = derive_seed(0, "surrogate validation set")


def validation_theta(family: Family, count: int = COUNT) -> Tensor:
    """Parameters (count,4) on the host: the 16 corners of the box, then uniform ones that no stream gives."""
    corners = family.from_unit(torch.tensor(list(itertools.product((0.0, 1.0), repeat=len(family.parameters)))))
    others = held_out_samples(family, max(0, count - len(corners)), SEED)
    return torch.cat([corners, others])[:count]


def validation_name(theta: Tensor) -> str:
    """Name of a set: the number of shapes and 16 digits of the SHA-256 of family, grid and parameters."""
    recipe = {"family": make_family("cochlea").fingerprint, "grid": grid_record(GRID)}
    digest = hashlib.sha256(json.dumps(recipe, sort_keys=True).encode())
    digest.update(theta.cpu().numpy().tobytes())
    return f"cochlea-{len(theta)}-{digest.hexdigest()[:16]}"


def validation_batches(theta: Tensor, device: torch.device | str, batch_size: int = 8) -> Iterator[Batch]:
    """The exact maps of parameters (N,4), a few at a time: fields theta (B,4) and sdm (B,1,80,64,40) [mm]."""
    maker = Maker(make_family("cochlea"), GRID, sampler=Table(theta, shuffle=False), device=device)
    for numbers in torch.arange(len(theta), device="cpu").split(batch_size):
        yield maker.make(numbers)
