"""Surrogates of the cochlea family: from four parameters to a signed distance map, without a mesh. See README.md."""

from sdm.surrogate.accuracy import Accuracy, measure
from sdm.surrogate.box import COARSE_GRID, GRID
from sdm.surrogate.exact import exact_map
from sdm.surrogate.models import MODELS, build
from sdm.surrogate.onnx import export_onnx
from sdm.surrogate.plus import SDMNNPlus
from sdm.surrogate.pod import PODChebyshev
from sdm.surrogate.sdmnn import SDMNN
from sdm.surrogate.settings import Settings
from sdm.surrogate.shipped import Predictor, load_surrogate, predict, shipped_weights
from sdm.surrogate.store import load_weights, save_weights
from sdm.surrogate.training import Trainer

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
