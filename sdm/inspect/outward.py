"""Meshes turned so that their faces look outward."""

from __future__ import annotations

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.mesh import TriangleMesh
from sdm.inspect.quick_look import look_at


def orient_outward(mesh: MeshLike) -> TriangleMesh:
    """Turn faces so that they face outward, where closed or nearly closed components say which side that is.

    1. Where faces that share an edge disagree, the fewer (by area) are turned: faces agree over every edge of exactly
       two. One-sided surfaces stay as they are.
    2. Then each component is judged by the volume that it encloses, gaps closed by flat caps: one that is inside no
       other and whose volume is negative is turned, with all that is inside it.

    So cavities stay cavities: a shell inside another keeps its meaning beside that one. Sheets and components that are
    wide open (flat caps over their gaps would be more than a third of their own area) have no inside to face, and are
    only made to agree. Components are what edges hold together.

    Args:
        mesh: Any mesh, on any device, or whatever `as_mesh` takes for one; looked at on the host.

    Returns:
        The same object if nothing is to be turned; else a mesh with the same vertices, and turned faces: the same ones
        for the same mesh.
    """
    mesh = as_mesh(mesh)
    faces = look_at(mesh).outward_faces(mesh)
    return mesh if faces is None else TriangleMesh(mesh.vertices, faces, mesh.name, check=False)
