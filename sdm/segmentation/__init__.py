"""Segmentation networks guided by distance maps: methods, data, training, prediction, scores.

Images and labels are (x,y,z), batches (B,1,x,y,z); distances are in mm and negative inside.
"""

from sdm.segmentation.data.case import Case
from sdm.segmentation.data.checks import check_cases
from sdm.segmentation.data.folder import has_part, read_cases
from sdm.segmentation.data.method_target import distance_map
from sdm.segmentation.data.patches import Patches
from sdm.segmentation.data.shape_labels import read_shapes
from sdm.segmentation.data.synthetic_patches import SyntheticPatches
from sdm.segmentation.data.write_prediction import write_prediction
from sdm.segmentation.infer.ensemble import check_ensemble, predict_ensemble
from sdm.segmentation.infer.label_scores import LabelScores, score_labels
from sdm.segmentation.infer.predict import Prediction, label_distance_map, largest_component, predict
from sdm.segmentation.infer.scores import cell, scores_of, table
from sdm.segmentation.infer.sliding_window import sliding_window
from sdm.segmentation.infer.validate import validate, validate_ensemble
from sdm.segmentation.networks.model import SegmentationModel
from sdm.segmentation.train.checkpoint import TrainedModel, load_model, load_settings, save_model
from sdm.segmentation.train.methods import MA_ROWS, METHODS, Method, method_called
from sdm.segmentation.train.settings import Settings
from sdm.segmentation.train.training import Training, train

__all__ = [
    "MA_ROWS",
    "METHODS",
    "Case",
    "LabelScores",
    "Method",
    "Patches",
    "Prediction",
    "SegmentationModel",
    "Settings",
    "SyntheticPatches",
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
    "read_shapes",
    "save_model",
    "score_labels",
    "scores_of",
    "sliding_window",
    "table",
    "train",
    "validate",
    "validate_ensemble",
    "write_prediction",
]
