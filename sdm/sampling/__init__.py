"""Training samples of a mesh: points near its surface, in a box and on it, with exact signed distances."""

from sdm.sampling.law import OCCUPANCY, PAPER, RELEASED, SampleLaw
from sdm.sampling.sample import PointSamples, sample
from sdm.sampling.surface_points import surface_points

__all__ = ["OCCUPANCY", "PAPER", "RELEASED", "PointSamples", "SampleLaw", "sample", "surface_points"]
