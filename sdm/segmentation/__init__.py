"""Segmentation networks guided by distance maps: methods, data, training, prediction, scores.

Images and labels are (x,y,z), batches (B,1,x,y,z); distances are in mm and negative inside.
"""

from sdm.segmentation.case import Case
from sdm.segmentation.checks import check_cases
from sdm.segmentation.ensemble import check_ensemble, predict_ensemble
from sdm.segmentation.folder import has_part, read_cases
from sdm.segmentation.methods import MA_ROWS, METHODS, Method, method_called
from sdm.segmentation.model import SegmentationModel
from sdm.segmentation.patches import Patches
from sdm.segmentation.predict import Prediction, label_distance_map, largest_component, predict
from sdm.segmentation.scores import cell, scores_of, table
from sdm.segmentation.settings import Settings
from sdm.segmentation.sliding import sliding_window
from sdm.segmentation.targets import distance_map
from sdm.segmentation.trained import TrainedModel, load_model, load_settings, save_model
from sdm.segmentation.training import Training, train
from sdm.segmentation.validate import validate, validate_ensemble
from sdm.segmentation.write import write_prediction

__all__ = [
    "MA_ROWS",
    "METHODS",
    "Case",
    "Method",
    "Patches",
    "Prediction",
    "SegmentationModel",
    "Settings",
    "TrainedModel",
    "Training",
    "cell",
    "check_cases",
    "check_ensemble",
    "distance_map",
    "has_part",
    "label_distance_map",
    "largest_component",
    "load_model",
    "load_settings",
    "method_called",
    "predict",
    "predict_ensemble",
    "read_cases",
    "save_model",
    "scores_of",
    "sliding_window",
    "table",
    "train",
    "validate",
    "validate_ensemble",
    "write_prediction",
]
