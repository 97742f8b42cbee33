"""Points with exact signed distances, made on the device, fresh for each step: DeepSDF's training data."""

from sdm.sampling.distribution import SampleDistribution
from sdm.sampling.samples import Samples, SampleSource
from sdm.sampling.shape_set import ShapeSet
from sdm.sampling.surface_points import surface_points
from sdm.sampling.unit_sphere import UnitSphere

__all__ = ["SampleDistribution", "SampleSource", "Samples", "ShapeSet", "UnitSphere", "surface_points"]
