"""Mesh inspection: closed, oriented, outward, manifold, and the problems found."""

from sdm.inspect.outward import orient_outward
from sdm.inspect.report import MeshReport, inspect_mesh

__all__ = ["MeshReport", "inspect_mesh", "orient_outward"]
