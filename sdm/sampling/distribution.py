"""Where DeepSDF's samples are: near the surface at two scales, and everywhere in the box."""

from __future__ import annotations

from dataclasses import dataclass

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
        """How many of `points` samples of a shape are near the surface: always the first ones.

        Of these the first, third, fifth ... have the first variance.
        """
        return round(self.near * points)
