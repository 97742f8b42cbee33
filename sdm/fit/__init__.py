"""Shapes and poses from CT-like images, with their uncertainty. See README.md beside this file."""

from sdm.fit.backend import Backend, Distances
from sdm.fit.exact import ExactBackend
from sdm.fit.pose import State
from sdm.fit.posterior import Posterior
from sdm.fit.result import FitError, FitResult
from sdm.fit.shape_fit import FitOptions, fit_shape
from sdm.fit.simulate import SCANNERS, Image, Scanner, random_state, simulate

__all__ = [
    "SCANNERS",
    "Backend",
    "Distances",
    "ExactBackend",
    "FitError",
    "FitOptions",
    "FitResult",
    "Image",
    "Posterior",
    "Scanner",
    "State",
    "fit_shape",
    "random_state",
    "simulate",
]
