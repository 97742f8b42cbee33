"""First maps of meshes by the recordings of their class: one for closed meshes, one for open ones.

Whether a mesh is closed is known once its faces are paired. Which recording is launched first, and made if there is
none, is a guess, by counts alone: the faces of a closed mesh are even in number, and as it has half as many edges
again, its vertices are half as many as its faces, and two more for each part, two less for each handle. A hole adds a
vertex for each two edges of its rim. The recording for open meshes serves closed ones too.
"""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.capacity.class_calls import ClassMap, class_call, class_key, open_class_call
from sdm.engine.capacity.classes import MOST_EDGES, CapacityClass
from sdm.engine.capacity.open_boundary import OpenBoundary
from sdm.kernels.dense.plan import Decisions
from sdm.runtime import graphs
from sdm.topology import guesses
from sdm.topology.cap_triangles import remember_joined
from sdm.topology.face_pairing import Pairing, remember, remember_closed

# Twice the vertices less the faces: of closed meshes 4 for each part, and 4 less for each handle. A mesh with more is
# more likely one with holes, whose edges add up to that.
MOST_OF_CLOSED = 12


def looks_closed(faces: int, vertices: int) -> bool:
    """True if a mesh of so many faces and vertices is more likely closed than not."""
    return faces % 2 == 0 and 2 * vertices - faces <= MOST_OF_CLOSED


def has_room(numbers: guesses.Guess) -> bool:
    """True if the recordings of a class serve meshes with as many unmatched and boundary edges."""
    return max(numbers) <= MOST_EDGES


def class_map(
    kind: CapacityClass, decisions: Decisions, vertices: Tensor, faces: Tensor, grid: Grid
) -> tuple[Tensor, Tensor | None] | None:
    """The map (nx,ny,nz) of a mesh of a class, and if it is open how many voxels are ambiguous (1,).

    None if there is no recording for it, or if it is none that these serve. Else its topology is remembered.
    """
    # What recordings read by address.
    vertices, given = vertices.contiguous(), faces.contiguous()
    if looks_closed(faces.shape[0], vertices.shape[0]):
        found, said = graphs.attempt_by_table(class_call(kind, decisions, vertices, given, grid))
        if found is not None:
            remember_closed(faces, vertices.shape[0], found.neighbours)
            return found.values, None
        # Flags of `class_call`.
        if said and (said[0] or said[1] or said[2] > MOST_EDGES):
            return None
        if not said and not graphs.is_recorded(faces.device, class_key(kind, is_open=True)):
            # Neither is made for one that is not due.
            return None
    found, said = graphs.attempt_by_table(open_class_call(kind, decisions, vertices, given, grid))
    if found is None:
        return None
    return found.values, _remember(vertices.shape[0], faces, found, *said[-2:])


def _remember(vertices: int, faces: Tensor, found: ClassMap, rows: int, edges: int) -> Tensor | None:
    """Remember the topology of faces that were just found open, and give the ambiguous voxels."""
    if rows == 0 or found.unmatched is None or found.boundary is None:
        remember_closed(faces, vertices, found.neighbours)
        return None
    ready = torch.cuda.Event() if faces.is_cuda else None
    if ready is not None:
        ready.record(torch.cuda.current_stream(faces.device))
    pairing = Pairing(found.unmatched[:rows], found.neighbours, ready=ready)
    remember(faces, vertices, pairing)
    boundary = OpenBoundary.of_memory(found.boundary)
    remember_joined(pairing, boundary.edges[:edges], boundary.caps[:edges])
    guesses.remember_numbers(faces, vertices, guesses.Guess(rows, edges))
    return found.ambiguous if edges else None
