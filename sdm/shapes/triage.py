"""Triage of a user's meshes: those that can be training data, and why others cannot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sdm.core.mesh import TriangleMesh
from sdm.inspect import inspect_mesh

if TYPE_CHECKING:
    from sdm.engine.arguments import Sign

# Arguments that take such meshes, as a sentence names them.
KEEP_OPEN, FLOOD = "open_meshes='keep'", "sign='flood'"


def reason_to_reject(mesh: TriangleMesh, *, keep_open: bool = False, sign: Sign = "winding") -> str | None:
    """Why the inside of a mesh is not what its maker meant, as a sentence; None for a mesh that is fine.

    Args:
        mesh: A mesh that has been turned outward, if it is to be, on the host.
        keep_open: Take meshes with holes or turned faces, whose inside follows the generalised winding number.
        sign: The method by which its maps are signed. All but "winding" mean something by faces that look inwards, and
            by doubled walls, which enclose no volume.

    A mesh that meets itself is fine: inside is where the winding number is more than one half. Repeated and zero-area
    faces change no distance.
    """
    report = inspect_mesh(mesh)
    size = max(high - low for low, high in zip(*report.bounds, strict=True))
    if not size > 0:
        return "it has size zero"
    if sign == "winding" and report.inside_out_components:
        return (
            f"{report.inside_out_components} of its {report.components} components are inside out; turn their faces in "
            "a mesh editor"
        )
    if sign == "winding" and report.closed and report.volume == 0:
        return f"it is closed but encloses no volume, so nothing is inside; what doubled walls shut off is by {FLOOD}"
    if report.closed or keep_open:
        return None
    if report.boundary_edges:
        return (
            f"it has holes ({report.boundary_edges:,} edges of one face only), so its inside is not defined; close "
            f"them, or take it all the same by {KEEP_OPEN}"
        )
    if not report.disagreeing_edges:
        return (
            f"{report.nonmanifold_edges:,} of its edges have more than two faces, and {report.duplicate_faces:,} faces "
            f"are copies of others, so its inside is not defined; remove these, or take it all the same by {KEEP_OPEN}"
        )
    return (
        f"its faces disagree which side is out along {report.disagreeing_edges:,} edges; make them consistent, or take "
        f"it all the same by {KEEP_OPEN}"
    )
