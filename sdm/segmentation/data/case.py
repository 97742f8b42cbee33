"""Case: one image with its label."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One case, on the host.

    Args:
        name: How messages and tables call it.
        image: (x,y,z) float32, as read.
        label: (x,y,z) bool, or whole numbers where classes were asked for; None where there is none.
        spacing: Size of a voxel along each axis in mm; 1 where the file does not say.
        affine: (4,4) from voxel indices to the scanner's coordinates.
        source: The image's file.
        space: NIfTI's number of the space that the affine leads to: 0 unknown, so that the affine is a guess, 1 the
            scanner's, and so on.
    """

    name: str
    image: Tensor
    label: Tensor | None
    spacing: tuple[float, float, float]
    affine: np.ndarray
    source: Path
    space: int = 1


def standardized(image: Tensor) -> Tensor:
    """An image with mean 0 and standard deviation 1, float32: scanners have no common scale of intensity."""
    values = image.double()
    return ((values - values.mean()) / values.std().clamp(min=1e-8)).to(torch.float32)
