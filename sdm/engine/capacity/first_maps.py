"""First maps of meshes by the recordings of their class: one for closed meshes, one for open ones.

Whether a mesh is closed is known once its faces are paired. Which recording is launched first is a guess, by counts
alone: the faces of a closed mesh are even in number, and as it has half as many edges again, its vertices are half as
many as its faces, and two more for each part, two less for each handle. A hole adds a vertex for each two edges of its
rim. The recording for open meshes serves closed ones too.
"""

from __future__ import annotations

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.capacity.class_calls import class_call, class_key, open_class_call
from sdm.engine.capacity.classes import MOST_EDGES, CapacityClass
from sdm.engine.capacity.open_boundary import OpenBoundary
from sdm.engine.capacity.tables import class_inputs, to_record
from sdm.runtime import graphs
from sdm.runtime.graphs import Call
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


def class_map(kind: CapacityClass, vertices: Tensor, faces: Tensor, grid: Grid) -> tuple[Tensor, Tensor | None] | None:
    """The map (nx,ny,nz) of a mesh of a class, and if it is open how many voxels are ambiguous (1,).

    None if there is no recording for it, or if it is none that these serve. Else its topology is remembered.
    """
    device, count = faces.device, faces.shape[0]
    closed, opened = (graphs.is_recorded(device, class_key(kind, is_open)) for is_open in (False, True))
    if not (closed or opened):
        return None
    inputs = class_inputs(kind, vertices, faces, grid)
    if closed and (not opened or looks_closed(count, vertices.shape[0])):
        found, said = graphs.attempt(class_call(kind, inputs))
        if found is not None:
            remember_closed(faces, vertices.shape[0], found[1][:count])
            return found[0][0], None
        # Flags of `class_call`.
        if len(said) < 3 or said[0] or said[1] or said[2] > MOST_EDGES:
            return None
    if not opened:
        return None
    found, said = graphs.attempt(open_class_call(kind, inputs))
    if found is None:
        return None
    if said[-2] == 0 and not closed:
        # Which would have served it at less cost.
        graphs.note(to_record(kind, class_call(kind, inputs)))
    values, memory, neighbours, unmatched = found
    return values[0], _remember(vertices.shape[0], faces, memory, neighbours[:count], unmatched, *said[-2:])


def _remember(
    vertices: int, faces: Tensor, memory: Tensor, neighbours: Tensor, unmatched: Tensor, rows: int, edges: int
) -> Tensor | None:
    """Remember the topology of faces that were just found open, and give the ambiguous voxels."""
    if rows == 0:
        remember_closed(faces, vertices, neighbours)
        return None
    ready = torch.cuda.Event() if faces.is_cuda else None
    if ready is not None:
        ready.record(torch.cuda.current_stream(faces.device))
    pairing = Pairing(unmatched[:rows], neighbours, ready=ready)
    remember(faces, vertices, pairing)
    boundary = OpenBoundary.of_memory(memory)
    remember_joined(pairing, boundary.edges[:edges], boundary.caps[:edges])
    guesses.remember_numbers(faces, vertices, guesses.Guess(rows, edges))
    return boundary.ambiguous[:1] if edges else None


def call_to_record(kind: CapacityClass, vertices: Tensor, faces: Tensor, grid: Grid, is_open: bool) -> Call:
    """The call of a class that would have served a mesh, to be recorded."""
    inputs = class_inputs(kind, vertices, faces, grid)
    return to_record(kind, open_class_call(kind, inputs) if is_open else class_call(kind, inputs))
