"""Points with exact signed distances, made on the device, fresh for each step: DeepSDF's training data."""

from sdm.deepsdf.samples.distribution import SampleDistribution
from sdm.deepsdf.samples.sample_source import Samples, SampleSource
from sdm.deepsdf.samples.shape_set import ShapeSet
from sdm.deepsdf.samples.unit_sphere import UnitSphere
from sdm.sampling.surface_points import surface_points

__all__ = ["SampleDistribution", "SampleSource", "Samples", "ShapeSet", "UnitSphere", "surface_points"]
