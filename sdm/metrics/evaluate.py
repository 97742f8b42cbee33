"""All metrics of one case at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sdm.metrics.contour import contour_dice
from sdm.metrics.masks import Mask, masks
from sdm.metrics.overlap import dice, jaccard
from sdm.metrics.surface import average_of, hausdorff_of, rms_of
from sdm.metrics.surface_voxels import surface_distances


@dataclass(frozen=True, kw_only=True)
class SegmentationScores:
    """Scores of one case; distances in mm.

    Args:
        dice: 0 to 1.
        jaccard: 0 to 1.
        contour_dice: 0 to 1.
        hausdorff95_mm: 95 % Hausdorff distance.
        average_surface_distance_mm: Symmetric.
        rms_surface_distance_mm: Symmetric.
        failed: Exactly one of prediction and truth is empty: overlaps are 0, distances infinite. Report how many
            cases failed beside a mean that leaves them out.
    """

    dice: float
    jaccard: float
    contour_dice: float
    hausdorff95_mm: float
    average_surface_distance_mm: float
    rms_surface_distance_mm: float
    failed: bool


def evaluate_segmentation(prediction: Mask, truth: Mask, spacing_mm: float | Sequence[float]) -> SegmentationScores:
    """Every metric of one case; the distances between the surfaces are found once.

    Args:
        prediction: (x,y,z), foreground not zero.
        truth: (x,y,z), foreground not zero.
        spacing_mm: Size of a voxel along each axis in mm, or one number.

    Raises:
        SDMError: The masks are not two volumes of one shape.
        GridError: The spacing is not positive.
    """
    prediction, truth = masks(prediction, truth)
    distances = surface_distances(prediction, truth, spacing_mm)
    return SegmentationScores(
        dice=dice(prediction, truth),
        jaccard=jaccard(prediction, truth),
        contour_dice=contour_dice(prediction, truth),
        hausdorff95_mm=hausdorff_of(distances),
        average_surface_distance_mm=average_of(distances),
        rms_surface_distance_mm=rms_of(distances),
        failed=bool(prediction.any()) != bool(truth.any()),
    )
