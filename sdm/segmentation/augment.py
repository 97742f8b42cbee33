"""Random changes of a patch: a pure function of (seed, step, place in the batch)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

Augment = Literal["none", "published", "affine", "strong"]

# Largest angle, scale, gain and shift of "affine" and of "strong".
LARGEST_ANGLE = {"affine": math.radians(15.0), "strong": math.radians(30.0)}
LARGEST_SCALE = {"affine": 1.15, "strong": 1.35}
GAIN = {"affine": 0.2, "strong": 0.3}
SHIFT = {"affine": 0.2, "strong": 0.3}
NOISE = 0.1
# Of "strong" alone: exponent of the intensities, logarithm of the coil's shading, share of blurred patches.
LARGEST_GAMMA, SHADING, BLURRED = 1.6, 0.3, 0.3


@dataclass(frozen=True)
class Draw:
    """What was drawn for one patch: independent parts, each used or not as the augmentation says."""

    case: int
    place: Tensor
    turn: Tensor
    scale: float
    gain: float
    shift: float
    noise: int
    gamma: float = 1.0
    shading: float = 0.0
    blur: float = 0.0


def draw(seed: int, step: int, row: int, cases: int, kind: Augment) -> Draw:
    """The random numbers of one patch.

    Args:
        seed: Of the run.
        step: Of the training, 0 or more.
        row: Place in the batch.
        cases: How many cases there are to choose from.
        kind: "none": only the case and the place. "published": also a quarter turn about z and a mirror image, as in
            Ma's code. "affine": also turns of up to 15 degrees about every axis, scales of 1/1.15 to 1.15, mirror
            images, and noise, gain and shift of the intensities. "strong": more of all these, and of what sets scanners
            apart: the contrast's exponent, smooth shading as of a coil, and blur.

    Returns:
        `place` (3,) in 0..1 and `turn` (3,3), a rotation or reflection.
    """
    random = torch.Generator().manual_seed(((seed * 1_000_003 + step) * 4099 + row) & (2**63 - 1))
    uniform = torch.rand(12, generator=random, dtype=torch.float64)
    case = min(int(uniform[0] * cases), cases - 1)
    noise = int(torch.randint(2**62, (1,), generator=random))
    if kind == "none":
        return Draw(case, uniform[1:4], torch.eye(3, dtype=torch.float64), 1.0, 1.0, 0.0, noise)
    if kind == "published":
        turn = torch.eye(3, dtype=torch.float64)
        for _ in range(int(uniform[4] * 4)):
            turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=torch.float64) @ turn
        axis = int(uniform[5] * 2)
        turn[axis] *= -1 if uniform[6] < 0.5 else 1
        return Draw(case, uniform[1:4], turn, 1.0, 1.0, 0.0, noise)
    angles = (2 * uniform[4:7] - 1) * LARGEST_ANGLE[kind]
    mirror = torch.diag(torch.where(uniform[7:10] < 0.5, -1.0, 1.0).double())
    scale = LARGEST_SCALE[kind] ** (2 * float(uniform[10]) - 1)
    gain, shift = (2 * torch.rand(2, generator=random, dtype=torch.float64) - 1).tolist()
    drawn = Draw(
        case, uniform[1:4], rotation(angles) @ mirror, scale, 1 + GAIN[kind] * gain, SHIFT[kind] * shift, noise
    )
    if kind == "affine":
        return drawn
    gamma, shading, blurred, blur = torch.rand(4, generator=random, dtype=torch.float64).tolist()
    return replace(
        drawn,
        gamma=LARGEST_GAMMA ** (2 * gamma - 1),
        shading=SHADING * shading,
        blur=blur if blurred < BLURRED else 0.0,
    )


def rotation(angles: Tensor) -> Tensor:
    """The rotation (3,3) by angles (3,) in radians about x, then y, then z."""
    matrix = torch.eye(3, dtype=torch.float64)
    for axis, angle in enumerate(angles.tolist()):
        first, second = [a for a in range(3) if a != axis]
        turn = torch.eye(3, dtype=torch.float64)
        turn[first, first] = turn[second, second] = math.cos(angle)
        turn[first, second], turn[second, first] = -math.sin(angle), math.sin(angle)
        matrix = turn @ matrix
    return matrix
