"""Metrics of segmentations: overlap, and distances between surfaces in millimetres.

An empty prediction is a failure: overlap 0 and distance infinite. Where the truth is empty as well nothing can be
said, and every metric is NaN.
"""

from sdm.metrics.contour import contour_dice
from sdm.metrics.evaluate import SegmentationScores, evaluate_segmentation
from sdm.metrics.overlap import dice, jaccard
from sdm.metrics.surface import average_surface_distance, hausdorff_distance, rms_surface_distance
from sdm.metrics.surface_voxels import SurfaceDistances, surface_distances, surface_voxels

__all__ = [
    "SegmentationScores",
    "SurfaceDistances",
    "average_surface_distance",
    "contour_dice",
    "dice",
    "evaluate_segmentation",
    "hausdorff_distance",
    "jaccard",
    "rms_surface_distance",
    "surface_distances",
    "surface_voxels",
]
