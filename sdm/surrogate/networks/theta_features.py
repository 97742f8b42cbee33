"""Features of four shape parameters that a small network can use."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from sdm.shapes import families

# Degree of the Chebyshev polynomials of each parameter, and turning angles [rad] of places on the centre line.
DEGREE = 4
ANGLES = tuple(k * math.radians(671) / 11 for k in range(12))
FADING_MM = 1.0


class ThetaFeatures(nn.Module):
    """(B,4) parameters (a, alpha, b, phi) to (B,52) features of order one.

    Chebyshev polynomials T1 to T4 of each parameter, scaled to [-1, 1]; and of the centre line at 12 angles t the
    radius a exp(-b t), its fade s / sqrt(s^2 + 1) and the wave alpha fade cos(t - phi), whose dependence on theta is
    what makes the maps differ most.
    """

    width = 4 * DEGREE + 3 * len(ANGLES)
    middle: Tensor
    reach: Tensor
    angles: Tensor

    def __init__(self) -> None:
        super().__init__()
        box = torch.tensor([[p.low, p.high] for p in families["cochlea"].parameters], dtype=torch.float64)
        # Not part of the state: they follow from the family.
        self.register_buffer("middle", box.mean(1).float(), persistent=False)
        self.register_buffer("reach", ((box[:, 1] - box[:, 0]) / 2).float(), persistent=False)
        self._middle, self._reach = self.middle.tolist(), self.reach.tolist()
        self.register_buffer("angles", torch.tensor(ANGLES, dtype=torch.float32), persistent=False)

    def of_one(self, theta: list[float]) -> list[float]:
        """The features (52,) of one theta (4,) by Python's own numbers: a fourth of the time of small operations."""
        one = [1.0] * len(theta)
        unit = [(x - m) / r for x, m, r in zip(theta, self._middle, self._reach, strict=True)]
        terms = [one, unit]
        for _ in range(DEGREE - 1):
            terms.append([2 * x * b - a for x, a, b in zip(unit, terms[-2], terms[-1], strict=True)])
        a, alpha, b, phi = theta
        radius = [a * math.exp(-b * angle) for angle in ANGLES]
        fade = [r / math.sqrt(r * r + FADING_MM**2) for r in radius]
        wave = [alpha * f * math.cos(angle - phi) for f, angle in zip(fade, ANGLES, strict=True)]
        polynomials = [x for row in terms[1:] for x in row]
        return [*polynomials, *(r / 2 - 1 for r in radius), *(2 * f - 1 for f in fade), *wave]

    def unit(self, theta: Tensor) -> Tensor:
        """Parameters (B,4) scaled to [-1, 1]."""
        return (theta - self.middle) / self.reach

    def forward(self, theta: Tensor) -> Tensor:
        """Features (B,52) of theta (B,4)."""
        polynomials = chebyshev(self.unit(theta), DEGREE)[1:]
        a, alpha, b, phi = (theta[:, i : i + 1] for i in range(4))
        radius = a * torch.exp(-b * self.angles)
        fade = radius / torch.sqrt(radius * radius + FADING_MM**2)
        wave = alpha * fade * torch.cos(self.angles - phi)
        return torch.cat([*polynomials, radius / 2 - 1, 2 * fade - 1, wave], 1)


def chebyshev(x: Tensor, degree: int) -> list[Tensor]:
    """T0 to T`degree` of x, each of x's shape."""
    terms = [torch.ones_like(x), x]
    for _ in range(degree - 1):
        terms.append(2 * x * terms[-1] - terms[-2])
    return terms[: degree + 1]
