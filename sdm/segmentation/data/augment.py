"""Random changes of a patch: a pure function of (seed, step, place in the batch)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from sdm.core.random import derive_seed, generator

Augment = Literal["none", "published", "affine", "strong", "scanner"]


@dataclass(frozen=True, kw_only=True)
class Ranges:
    """Ranges of an augmentation's changes.

    Args:
        degrees: Largest turn about each axis.
        scale: Largest scale.
        brightness: Largest gain less 1, and largest shift; images have a standard deviation of 1.
        noise: Least and largest standard deviation.
        gamma: Largest exponent of the intensities.
        shading: Largest deviation of the logarithm of a coil's shading.
        blurred: Share of blurred patches.
    """

    degrees: float
    scale: float
    brightness: float
    noise: tuple[float, float] = (0.1, 0.1)
    gamma: float = 1.0
    shading: float = 0.0
    blurred: float = 0.0


RANGES = {
    "affine": Ranges(degrees=15.0, scale=1.15, brightness=0.2),
    "strong": Ranges(degrees=30.0, scale=1.35, brightness=0.3, gamma=1.6, shading=0.3, blurred=0.3),
    "scanner": Ranges(degrees=15.0, scale=1.15, brightness=0.3, noise=(0.0, 0.4), gamma=1.3, shading=0.3, blurred=0.3),
}


@dataclass(frozen=True)
class Draw:
    """Random draw for one patch: independent parts, each used or not as the augmentation says."""

    case: int
    place: Tensor
    turn: Tensor
    scale: float
    gain: float
    shift: float
    seed: int
    noise: float = 0.1
    gamma: float = 1.0
    shading: float = 0.0
    blur: float = 0.0


def draw(seed: int, step: int, row: int, cases: int, kind: Augment, *, mirrors: str = "xyz") -> Draw:
    """The random numbers of one patch.

    Args:
        seed: Of the run.
        step: Of the training, 0 or more.
        row: Place in the batch.
        cases: How many cases there are to choose from.
        kind: "none": only the case and the place. "published": also a quarter turn about z and a mirror image, as in
            Ma's code. "affine": also turns of up to 15 degrees about every axis, scales of 1/1.15 to 1.15, mirror
            images, and noise, gain and shift of the intensities. "strong": more of all these, and of what sets scanners
            apart: the contrast's exponent, smooth shading as of a coil, and blur. "scanner": turned and scaled as
            "affine", intensities about as "strong", and noise of any strength up to 0.4, coarser than the voxels.
        mirrors: The axes along which "affine", "strong" and "scanner" mirror, each with a chance of a half.

    Returns:
        `place` (3,) in 0..1, `turn` (3,3), a rotation or reflection, and `seed`, of the patch's noise.
    """
    random = generator(seed, "segmentation patch", step, row)
    uniform = torch.rand(12, generator=random, dtype=torch.float64, device="cpu")
    case = min(int(uniform[0] * cases), cases - 1)
    own = derive_seed(seed, "segmentation patch noise", step, row)
    if kind == "none":
        return Draw(case, uniform[1:4], torch.eye(3, dtype=torch.float64, device="cpu"), 1.0, 1.0, 0.0, own)
    if kind == "published":
        turn = torch.eye(3, dtype=torch.float64, device="cpu")
        for _ in range(int(uniform[4] * 4)):
            turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=torch.float64, device="cpu") @ turn
        axis = int(uniform[5] * 2)
        turn[axis] *= -1 if uniform[6] < 0.5 else 1
        return Draw(case, uniform[1:4], turn, 1.0, 1.0, 0.0, own)
    ranges = RANGES[kind]
    turn = rotation((2 * uniform[4:7] - 1) * math.radians(ranges.degrees))
    allowed = torch.tensor([axis in mirrors for axis in "xyz"], device="cpu")
    turn = turn @ torch.diag(torch.where(allowed & (uniform[7:10] < 0.5), -1.0, 1.0).double())
    scale = ranges.scale ** (2 * float(uniform[10]) - 1)
    gain, shift = (
        ranges.brightness * (2 * torch.rand(2, generator=random, dtype=torch.float64, device="cpu") - 1)
    ).tolist()
    drawn = Draw(case, uniform[1:4], turn, scale, 1 + gain, shift, own)
    if kind == "affine":
        return drawn
    gamma, shading, blurred, blur, noise = torch.rand(5, generator=random, dtype=torch.float64, device="cpu").tolist()
    least, most = ranges.noise
    return replace(
        drawn,
        noise=least + (most - least) * noise,
        gamma=ranges.gamma ** (2 * gamma - 1),
        shading=ranges.shading * shading,
        blur=blur if blurred < ranges.blurred else 0.0,
    )


def rotation(angles: Tensor) -> Tensor:
    """The rotation (3,3) by angles (3,) in radians about x, then y, then z."""
    matrix = torch.eye(3, dtype=torch.float64, device="cpu")
    for axis, angle in enumerate(angles.tolist()):
        first, second = [a for a in range(3) if a != axis]
        turn = torch.eye(3, dtype=torch.float64, device="cpu")
        turn[first, first] = turn[second, second] = math.cos(angle)
        turn[first, second], turn[second, first] = -math.sin(angle), math.sin(angle)
        matrix = turn @ matrix
    return matrix
