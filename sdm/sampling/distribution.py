"""Where DeepSDF's samples are: near the surface at two scales, and everywhere in the box."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.errors import SDMError


@dataclass(frozen=True, kw_only=True)
class SampleDistribution:
    """J. Park et al., CVPR 2019, section 5: the shares and variances of their 500,000 samples a shape.

    Args:
        near: Share of the samples around points of the surface; half of them have each variance, the rest is
            uniform in the box.
        variances: Of the normal offset along each axis, in squared unit-sphere radii.
        box: Half the edge of the box around the origin.
    """

    near: float = 0.94
    variances: tuple[float, float] = (0.005, 0.0005)
    box: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.near <= 1 or min(self.variances) < 0 or self.box <= 0:
            raise SDMError(f"{self} is no distribution: near is a share, variances and box are positive")

    def near_count(self, points: int) -> int:
        """How many of `points` samples of a shape are near the surface: always the first ones."""
        return round(self.near * points)

    def offsets(self, uniform: Tensor) -> Tensor:
        """Normal offsets (...,N,3) from uniform numbers (...,N,4): even samples have the first variance."""
        count = uniform.shape[-2]
        deviation = torch.tensor([math.sqrt(v) for v in self.variances], device=uniform.device)
        scale = deviation[torch.arange(count, device=uniform.device) % 2]
        # Box and Muller: two pairs of numbers make four normal ones, of which three are used. 1 - u is never 0.
        length = (-2 * (1 - uniform[..., 0::2]).log()).sqrt()
        angle = 2 * math.pi * uniform[..., 1::2]
        normal = torch.cat([length * angle.cos(), (length * angle.sin())[..., :1]], -1)
        return normal * scale[:, None]

    def anywhere(self, uniform: Tensor) -> Tensor:
        """Points (...,3) of the box from uniform numbers (...,3)."""
        return self.box * (2 * uniform - 1)
