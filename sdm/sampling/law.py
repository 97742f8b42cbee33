"""Law of training samples: how many are near the surface, anywhere in the box, and on the surface."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.core.given_values import real, whole
from sdm.errors import SDMError

NEAR, UNIFORM, SURFACE = 0, 1, 2


@dataclass(frozen=True, kw_only=True)
class SampleLaw:
    """Shares and spread of samples. Of every `near + uniform + surface` numbers in a row each kind has its share.

    Args:
        near: Of these so many are points of the surface, moved by independent normal offsets along each axis.
        uniform: So many are anywhere in the box.
        surface: So many are on the surface.
        deviations: Standard deviations of the offsets, in the unit of the (normalised) mesh; samples take them in turn.
        box: Half the edge of the box around the origin, in the same unit.

    Raises:
        SDMError: Numbers that make no sense.
    """

    near: int = 95
    uniform: int = 5
    surface: int = 0
    deviations: tuple[float, ...] = (math.sqrt(0.0025), math.sqrt(0.00025))
    box: float = 1.0

    def __post_init__(self) -> None:
        shares = (self.near, self.uniform, self.surface)
        if not isinstance(self.deviations, list | tuple):
            raise SDMError(f"the deviations are {self.deviations!r}; give lengths, such as (0.05, 0.02)")
        lengths = (*self.deviations, self.box)
        if None in (whole(share, 0) for share in shares) or sum(shares) == 0 or (self.near and not self.deviations):
            raise SDMError(
                f"near, uniform, surface = {', '.join(map(str, shares))} is no law: give whole numbers of at least 0, "
                "not all of them 0; and samples near the surface need deviations"
            )
        if wrong := [length for length in lengths if not 0 <= real(length) < math.inf]:
            raise SDMError(f"{wrong[0]!r} is no law: deviations and the box's half edge are lengths of at least 0")

    def kinds(self, numbers: Tensor) -> Tensor:
        """The kind of each sample by its number (N,) int64: 0 near the surface, 1 anywhere, 2 on the surface."""
        place = numbers % (self.near + self.uniform + self.surface)
        return (place >= self.near).long() + (place >= self.near + self.uniform).long()

    def deviation_of(self, numbers: Tensor) -> Tensor:
        """The standard deviation (N,) float64 of the offset of each sample."""
        known = torch.tensor(self.deviations or (0.0,), dtype=torch.float64, device=numbers.device)
        return known[numbers % len(known)]


# J. Park et al., DeepSDF, CVPR 2019, section 5: of 500,000 samples 25,000 in the box, the others by two variances.
PAPER = SampleLaw()
# Their released code (PreprocessMesh.cpp): 47 % by the variance 0.005, 47 % by 0.0005, 6 % in the box.
RELEASED = SampleLaw(near=94, uniform=6, deviations=(math.sqrt(0.005), math.sqrt(0.0005)))
# L. Mescheder et al., Occupancy Networks, CVPR 2019: uniform in a box that is a tenth larger than the shape's cube.
OCCUPANCY = SampleLaw(near=0, uniform=1, deviations=(), box=1.1)
