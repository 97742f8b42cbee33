"""Overlap near the truth's contour."""

from __future__ import annotations

from torch.nn import functional

from sdm.core.given_values import whole
from sdm.errors import SDMError
from sdm.metrics.masks import Mask, masks
from sdm.metrics.overlap import dice


def contour_dice(prediction: Mask, truth: Mask, width: int = 5) -> float:
    """Dice over the voxels near the truth's contour alone, which the bulk of a large organ cannot hide.

    The band is every voxel whose cube of width^3 voxels holds foreground and background of the truth: its dilation by
    the cube without its erosion. 5^3 is that of Juhl et al., MIDL 2019. What lies beyond the volume is neither.

    Args:
        prediction: (x,y,z), foreground not zero.
        truth: (x,y,z), foreground not zero.
        width: Edge of the cube in voxels; odd.

    Returns:
        0 to 1; 0 where one of the masks is empty, NaN where both are or where the truth, being full, has no contour.

    Raises:
        SDMError: Another width, or masks that do not fit together.
    """
    edge = whole(width, 3)
    if edge is None or edge % 2 == 0:
        raise SDMError(f"the band's cube must be an odd number of voxels wide, at least 3, not {width!r}")
    prediction, truth = masks(prediction, truth)
    if prediction.any() and not truth.any():
        return 0.0
    value = truth.float()[None, None]
    dilated = functional.max_pool3d(value, edge, 1, edge // 2) > 0
    eroded = -functional.max_pool3d(-value, edge, 1, edge // 2) > 0
    band = (dilated & ~eroded)[0, 0]
    if truth.all():
        # A truth without background has no contour.
        return float("nan") if prediction.any() else 0.0
    return dice(prediction & band, truth & band)
