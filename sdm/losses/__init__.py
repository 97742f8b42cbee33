"""Losses for segmentation and signed distance regression, and schedules of their weights.

Predictions and targets are (B,1,x,y,z). Signed distances are negative inside.
"""

from sdm.losses.boundary import boundary_loss
from sdm.losses.clamped_l1 import clamped_l1_loss
from sdm.losses.class_maps import class_maps
from sdm.losses.cross_entropy import cross_entropy_loss
from sdm.losses.dice import dice_loss
from sdm.losses.hausdorff import hausdorff_distance_loss
from sdm.losses.sdf_product import probability_from_sdf, sdf_product_loss
from sdm.losses.targets import foreground_distance, normalized_signed_distance, signed_distance_target
from sdm.losses.weighted_mse import clipped_sdf, inverse_weighted_mse_loss
from sdm.training.schedules import Schedule, constant, linear, sigmoid_rampup, stepwise

__all__ = [
    "Schedule",
    "boundary_loss",
    "clamped_l1_loss",
    "class_maps",
    "clipped_sdf",
    "constant",
    "cross_entropy_loss",
    "dice_loss",
    "foreground_distance",
    "hausdorff_distance_loss",
    "inverse_weighted_mse_loss",
    "linear",
    "normalized_signed_distance",
    "probability_from_sdf",
    "sdf_product_loss",
    "sigmoid_rampup",
    "signed_distance_target",
    "stepwise",
]
