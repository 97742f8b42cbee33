"""CT-like images of shapes whose truth is known: partial volume, blur and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.given_values import real
from sdm.core.grid import Grid
from sdm.core.random import derive_seed
from sdm.errors import SDMError
from sdm.fit.model.backend import Backend
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State

# Sample points of a simulated image are this far apart at most [mm]: finer than any fit's.
FINE = 0.05
# The logistic's length is this part of that: it moves a round surface outwards by its square.
SHARP = 8


@dataclass(frozen=True)
class Scanner:
    """A scanner, as it images a fluid-filled space in bone. Intensities in Hounsfield units.

    Args:
        spacing: Voxel size [mm].
        blur: Standard deviation of its Gaussian point spread function [mm].
        noise: Standard deviation of the noise, white.
        inside: Intensity of the fluid.
        outside: Intensity of the bone.
    """

    spacing: float
    blur: float
    noise: float
    inside: float = 100.0
    outside: float = 1700.0


# Multi-slice CT of the temporal bone, and a cone-beam scanner.
CLINICAL = Scanner(spacing=0.3, blur=0.25, noise=200.0)
FINE_CT = Scanner(spacing=0.2, blur=0.17, noise=250.0)
SCANNERS = {"0.3": CLINICAL, "0.2": FINE_CT}


@dataclass(frozen=True, eq=False)
class Image:
    """Intensities (nx,ny,nz) float32 at a grid's voxels."""

    values: Tensor
    grid: Grid


def simulate(
    backend: Backend, state: State, scanner: Scanner, *, seed: int, margin: float = 1.5, grid: GridLike | None = None
) -> Image:
    """An image of a shape.

    Args:
        backend: Where its distances come from: finer than the fit's, so that the fit does not meet its own errors.
        state: The true shape and pose.
        scanner: How it is seen.
        seed: Of the noise and of where the voxels lie: a pure function of it.
        margin: Bone around the shape's mean box [mm], of a cochlea.
        grid: Where the voxels are, a `Grid` or an image; by default around a cochlea. Other families need it.
    """
    generator = np.random.default_rng(derive_seed(seed, "simulated image"))
    grid = _grid(state, scanner.spacing, margin, generator) if grid is None else as_grid(grid)
    renderer = Renderer(grid, backend, blur=scanner.blur, length=FINE / SHARP, fine=FINE)
    share = renderer(state, derivatives=False).share.cpu()
    noise = torch.from_numpy(generator.standard_normal(grid.shape))
    values = scanner.outside + (scanner.inside - scanner.outside) * share + scanner.noise * noise
    return Image(values.float(), grid)


def random_state(backend: Backend, seed: int, *, turn: float = 0.2, shift: float = 0.5, edge: float = 0.0) -> State:
    """A random shape, uniform over the ranges but for `edge` of each at both ends, in a random pose.

    Args:
        backend: The family's.
        seed: A pure function of it.
        turn: Standard deviation of the rotation about each axis [rad].
        shift: Standard deviation of the translation along each axis [mm].
        edge: Share of each range to leave out at each end.

    Raises:
        SDMError: A deviation or a share that is none.
    """
    if not (0 <= real(turn) < math.inf and 0 <= real(shift) < math.inf and 0 <= real(edge) <= 0.5):
        raise SDMError(f"turn, shift and edge are {turn!r}, {shift!r} and {edge!r}; give 0 or more, and at most half")
    generator = np.random.default_rng(derive_seed(seed, "random state"))
    unit = edge + (1 - 2 * edge) * generator.random(len(backend.parameters))
    low, high = (np.array([getattr(p, end) for p in backend.parameters]) for end in ("low", "high"))
    base = State(
        torch.as_tensor(low + (high - low) * unit, device=backend.device),
        torch.eye(3, dtype=torch.float64, device=backend.device),
        torch.zeros(3, dtype=torch.float64, device=backend.device),
        backend.centre,
    )
    turned, shifted = turn * generator.standard_normal(3), shift * generator.standard_normal(3)
    pose = np.concatenate([np.zeros(len(low)), turned, shifted])
    return base.moved(torch.as_tensor(pose, device=backend.device))


def _grid(state: State, spacing: float, margin: float, generator: np.random.Generator) -> Grid:
    # A box that holds every cochlea of the family turned a little; a cropped scan.
    a = float(state.theta[0]) if state.theta.numel() else 4.0
    half = np.array([1.35 * a + margin, 1.2 * a + margin, 2.4 + margin])
    count = np.ceil(2 * half / spacing).astype(int)
    jitter = generator.uniform(-0.5, 0.5, 3) * spacing
    origin = state.translation.cpu().numpy() - spacing * (count - 1) / 2 + jitter
    return Grid(origin, (spacing,) * 3, count)
