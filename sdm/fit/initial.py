"""Where to begin: a few plain shapes, each laid over the image wherever it explains most of it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.fit.backend import Backend
from sdm.fit.pose import State
from sdm.fit.render import Renderer
from sdm.grid import Grid

# Where in each range the plain shapes are: all corners of this smaller box, and the middle.
PLACES = (0.25, 0.75)
COARSE = 0.6
LENGTH = 0.15


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
    """Plain shapes in each of some rotations, best first.

    Args:
        backend: Where distances come from.
        image: (nx,ny,nz) float64 intensities; a coarse image is enough.
        grid: Its grid.
        pose: The expected pose; only its rotation counts, the translation is searched through the whole image.
        rotations: Rotation matrices (3,3) to put after the expected one, in the shape's own frame.

    The translation comes from a cross-correlation by FFT. Bright or dark insides are found alike.
    """
    renderer = Renderer(grid, backend, blur=0.0, length=LENGTH, fine=max(grid.spacing))
    low, high = (torch.tensor([getattr(p, end) for p in backend.parameters]).double() for end in ("low", "high"))
    units = [*itertools.product(PLACES, repeat=len(low)), (0.5,) * len(low)]
    centred = image - image.mean()
    size = [2 * n for n in grid.shape]
    spectrum = torch.fft.rfftn(centred, s=size)
    middle = middle_of(grid).to(image.device)
    axes = torch.from_numpy(grid.affine[:3, :3]).to(image.device)
    found = []
    for unit, turn in itertools.product(units, rotations):
        theta = (low + (high - low) * torch.tensor(unit).double()).to(image.device)
        state = State(theta, pose.rotation @ turn, middle, backend.centre)
        share = renderer(state, derivatives=False).share
        template = share - share.mean()
        power = float((template**2).sum())
        if power == 0:
            continue
        product = torch.fft.irfftn(spectrum * torch.fft.rfftn(template, s=size).conj(), s=size)
        best = int(product.abs().argmax())
        index = torch.tensor(torch.unravel_index(torch.tensor(best), product.shape)).to(image.device)
        limits = torch.tensor(size, device=image.device)
        shift = torch.where(index > limits // 2, index - limits, index).double()
        explained = float(product.flatten()[best]) ** 2 / power / float((centred**2).sum().clamp_min(1e-30))
        found.append(Candidate(State(theta, state.rotation, middle + axes @ shift, backend.centre), explained))
    return sorted(found, key=lambda c: -c.explained)
