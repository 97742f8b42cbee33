"""Shapes and poses from CT-like images, with their uncertainty. See README.md beside this file."""

from sdm.fit.model.backend import Backend, Distances
from sdm.fit.model.backends import make_backends
from sdm.fit.model.exact import ExactBackend
from sdm.fit.model.pose import State
from sdm.fit.model.spline_backend import GridBackend
from sdm.fit.solve.fit_shape import FitOptions, fit_shape
from sdm.fit.solve.nuts import Samples, sample_posterior
from sdm.fit.solve.posterior import Posterior
from sdm.fit.solve.result import FitError, FitResult
from sdm.fit.study.simulate import SCANNERS, Image, Scanner, random_state, simulate

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
