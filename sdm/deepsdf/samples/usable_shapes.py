"""Meshes that a shape set can take, and why it cannot take others."""

from __future__ import annotations

from sdm.core.mesh import TriangleMesh
from sdm.deepsdf.samples.unit_sphere import UnitSphere
from sdm.errors import MeshError
from sdm.topology.boundary_edges import boundary_edges


def why_unusable(mesh: TriangleMesh) -> str | None:
    """Why a mesh cannot be sampled, as a sentence about it; None for one that can."""
    try:
        UnitSphere.of(mesh)
    except MeshError:
        return "it has no size"
    edges = boundary_edges(mesh.vertices.detach(), mesh.faces).shape[0]
    return f"it is not closed ({edges:,} edges of one face), so its inside is not defined" if edges else None
