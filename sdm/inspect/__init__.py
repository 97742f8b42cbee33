"""What a mesh is like: closed, oriented, outward, manifold, and what is wrong with it."""

from sdm.inspect.orientation import orient_outward
from sdm.inspect.report import MeshReport, inspect_mesh

__all__ = ["MeshReport", "inspect_mesh", "orient_outward"]
