"""Shapes and poses from CT-like images, with their uncertainty. See README.md beside this file."""

from sdm.fit.backend import Backend, Distances
from sdm.fit.backends import make_backends
from sdm.fit.exact import ExactBackend
from sdm.fit.from_grid import GridBackend
from sdm.fit.nuts import Samples, sample_posterior
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
    "GridBackend",
    "Image",
    "Posterior",
    "Samples",
    "Scanner",
    "State",
    "fit_shape",
    "make_backends",
    "random_state",
    "sample_posterior",
    "simulate",
]
