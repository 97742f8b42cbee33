"""Endless training data: exact signed distance maps of random shapes, made on the device as they are needed."""

from sdm.stream.batch import Batch
from sdm.stream.sample_maker import Maker
from sdm.stream.samplers import Chebyshev, Mixture, Sampler, Sobol, Table, TensorGrid, Uniform, as_sampler
from sdm.stream.stream import SDMStream
from sdm.stream.validation_set import ValidationSet

__all__ = [
    "Batch",
    "Chebyshev",
    "Maker",
    "Mixture",
    "SDMStream",
    "Sampler",
    "Sobol",
    "Table",
    "TensorGrid",
    "Uniform",
    "ValidationSet",
    "as_sampler",
]
