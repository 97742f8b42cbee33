"""Surrogates of the cochlea family: from four parameters to a signed distance map, without a mesh. See README.md."""

from sdm.surrogate.infer.exact_map import exact_map
from sdm.surrogate.infer.onnx import export_onnx
from sdm.surrogate.infer.predict import Predictor, load_surrogate, predict, shipped_weights
from sdm.surrogate.infer.weights_file import load_weights, save_weights
from sdm.surrogate.networks.cochlea_grid import COARSE_GRID, GRID
from sdm.surrogate.networks.models import MODELS, build
from sdm.surrogate.networks.pod_chebyshev import PODChebyshev
from sdm.surrogate.networks.sdmnn import SDMNN
from sdm.surrogate.networks.sdmnn_plus import SDMNNPlus
from sdm.surrogate.train.accuracy import Accuracy, measure
from sdm.surrogate.train.settings import Settings
from sdm.surrogate.train.training import Trainer

__all__ = [
    "COARSE_GRID",
    "GRID",
    "MODELS",
    "SDMNN",
    "Accuracy",
    "PODChebyshev",
    "Predictor",
    "SDMNNPlus",
    "Settings",
    "Trainer",
    "build",
    "exact_map",
    "export_onnx",
    "load_surrogate",
    "load_weights",
    "measure",
    "predict",
    "save_weights",
    "shipped_weights",
]
