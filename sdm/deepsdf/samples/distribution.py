"""Distribution of DeepSDF's samples: near the surface at two scales, and everywhere in the box."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sdm.errors import SDMError

# Samples reach no further along each axis, in unit-sphere radii: there the nearest shape of a scene is their own.
REACH = 1.5


@dataclass(frozen=True, kw_only=True)
class SampleDistribution:
    """J. Park et al., CVPR 2019, section 5: the shares and variances of their 500,000 samples a shape.

    Args:
        near: Share of the samples around points of the surface; half of them have each variance, the rest is
            uniform in the box.
        variances: Of the normal offset along each axis, in squared unit-sphere radii.
        box: Half the edge of the box around the origin, at most 1.5.

    Raises:
        SDMError: A number that makes no sense.
    """

    near: float = 0.94
    variances: tuple[float, float] = (0.005, 0.0005)
    box: float = 1.0

    def __post_init__(self) -> None:
        if not (0 <= self.near <= 1 and all(0 <= v < math.inf for v in self.variances) and 0 < self.box <= REACH):
            raise SDMError(
                f"{self} is no distribution: near is a share, variances are not negative, and box is above 0 and at "
                f"most {REACH}"
            )

    def near_count(self, points: int) -> int:
        """Number of `points` samples of a shape that are near the surface: always the first ones.

        Of these the first, third, fifth ... have the first variance.
        """
        return round(self.near * points)
