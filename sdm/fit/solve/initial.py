"""Initial states: a few plain shapes, each laid over the image wherever it explains most of it."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.fit.model.backend import Backend
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State

# Where in each range the plain shapes are: all corners of this smaller box, and the middle. Of more parameters than
# `MOST_CORNERS`, one at a time, the first `MOST_ALONE`: a shape model has its largest modes first.
PLACES = (0.25, 0.75)
MOST_CORNERS, MOST_ALONE = 5, 8
COARSE = 0.6
LENGTH = 0.15
# How many of the best are turned too.
TURNED, FEW = 3, 6


@dataclass(frozen=True, eq=False)
class Candidate:
    """A state, and the share of the image's variance that it explains, 0 to 1."""

    state: State
    explained: float


def coarser(image: Tensor, grid: Grid, spacing: float = COARSE) -> tuple[Tensor, Grid]:
    """An image (nx,ny,nz) averaged over blocks of voxels, to about `spacing` [mm], and its grid."""
    factor = [max(1, min(n, round(spacing / s))) for s, n in zip(grid.spacing, grid.shape, strict=True)]
    shape = [n // f for n, f in zip(grid.shape, factor, strict=True)]
    cut = image[tuple(slice(0, n * f) for n, f in zip(shape, factor, strict=True))]
    blocks = cut.reshape([x for n, f in zip(shape, factor, strict=True) for x in (n, f)])
    shift = torch.tensor([s * (f - 1) / 2 for s, f in zip(grid.spacing, factor, strict=True)], dtype=torch.float64)
    origin = torch.tensor(grid.origin, dtype=torch.float64) + torch.tensor(grid.direction, dtype=torch.float64) @ shift
    wide = [s * f for s, f in zip(grid.spacing, factor, strict=True)]
    return blocks.mean((1, 3, 5)), Grid(origin.tolist(), wide, shape, grid.direction)


def middle_of(grid: Grid) -> Tensor:
    """The middle of a grid in the world (3,) float64."""
    half = torch.tensor([(n - 1) / 2 for n in grid.shape] + [1.0], dtype=torch.float64)
    return (torch.from_numpy(grid.affine) @ half)[:3]


def candidates(backend: Backend, image: Tensor, grid: Grid, pose: State, rotations: list[Tensor]) -> list[Candidate]:
    """Plain shapes, best first, each laid over the image; the best of them also turned.

    Args:
        backend: Where distances come from.
        image: (nx,ny,nz) float64 intensities; a coarse image is enough.
        grid: Its grid.
        pose: The expected pose; only its rotation counts, the translation is searched through the whole image.
        rotations: Rotation matrices (3,3) to put after the expected one, in the shape's own frame.

    The translation comes from a cross-correlation by FFT. Bright or dark insides are found alike.
    """
    low, high = (torch.tensor([getattr(p, end) for p in backend.parameters]).double() for end in ("low", "high"))
    units = _units(len(low))
    search = _Search(backend, image, grid)
    plain = [(low + (high - low) * torch.tensor(unit)).to(image.device) for unit in units]
    found = [search(State(theta, pose.rotation, search.middle, backend.centre)) for theta in plain]
    # Where all rotations are searched, what explains most unturned says nothing: the middle shape is turned.
    middle = found[-1:]
    found.sort(key=lambda c: -c.explained)
    turned = [
        search(State(c.state.theta, pose.rotation @ turn, search.middle, backend.centre))
        for c in (middle if len(rotations) > FEW else found[:TURNED])
        for turn in rotations
    ]
    return sorted(found + turned, key=lambda c: -c.explained)


def all_turns(turn: float, device: torch.device) -> list[Tensor]:
    """Rotation matrices (3,3) of the icosahedral group, no further than two deviations `turn` [rad] from none.

    No rotation is further than 45 degrees from the nearest of all 60, which is as far as steps find their way back.
    """
    from scipy.spatial.transform import Rotation

    group = Rotation.create_group("I")
    # Corners may be turned together about all three axes.
    reach = 2 * math.sqrt(3) * turn
    near = [r for r in group if 1e-6 < r.magnitude() <= reach]
    return [torch.from_numpy(r.as_matrix()).to(device) for r in near]


def of_other_rotations(found: list[Candidate]) -> list[Candidate]:
    """The best candidate of each rotation, best first: others of the same rotation end where it does."""
    kept: list[Candidate] = []
    for candidate in found:
        if not any(torch.allclose(candidate.state.rotation, k.state.rotation, atol=1e-6) for k in kept):
            kept.append(candidate)
    return kept


def _units(count: int) -> list[tuple[float, ...]]:
    """Places of the plain shapes in the unit cube."""
    middle = (0.5,) * count
    if count <= MOST_CORNERS:
        return [*itertools.product(PLACES, repeat=count), middle]
    alone = [(*middle[:k], x, *middle[k + 1 :]) for k in range(min(count, MOST_ALONE)) for x in PLACES]
    return [*alone, middle]


class _Search:
    """Cross-correlates an image with shapes, in every translation at once."""

    def __init__(self, backend: Backend, image: Tensor, grid: Grid) -> None:
        self.renderer = Renderer(grid, backend, blur=0.0, length=LENGTH, fine=max(grid.spacing))
        # Twice as large, so that what leaves on one side does not come in on the other.
        self.size = [2 * n for n in grid.shape]
        centred = image - image.mean()
        self.power = float((centred**2).sum().clamp_min(1e-30))
        self.spectrum = torch.fft.rfftn(centred, s=self.size)
        self.middle = middle_of(grid).to(image.device)
        self.axes = torch.from_numpy(grid.affine[:3, :3]).to(image.device)

    def __call__(self, state: State) -> Candidate:
        """The state, moved to where it explains most."""
        share = self.renderer(state, derivatives=False).share
        template = share - share.mean()
        power = float((template**2).sum())
        if power == 0:
            return Candidate(state, 0.0)
        product = torch.fft.irfftn(self.spectrum * torch.fft.rfftn(template, s=self.size).conj(), s=self.size)
        best = int(product.abs().argmax())
        index = torch.tensor(np.unravel_index(best, tuple(product.shape)), device=share.device)
        limit = torch.tensor(self.size, device=share.device)
        shift = self.axes @ torch.where(index > limit // 2, index - limit, index).double()
        explained = float(product.flatten()[best]) ** 2 / power / self.power
        return Candidate(State(state.theta, state.rotation, state.translation + shift, state.centre), explained)
