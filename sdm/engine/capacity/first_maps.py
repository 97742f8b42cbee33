"""First maps of meshes by the recordings of their class: one for closed meshes, one for open ones.

Whether a mesh is closed is known once its faces are paired. Which recording is launched first, and made if there is
none, is a guess, by counts alone: the faces of a closed mesh are even in number, and as it has half as many edges
again, its vertices are half as many as its faces, and two more for each part, two less for each handle. A hole adds a
vertex for each two edges of its rim. The recording for open meshes serves closed ones too.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.capacity.class_calls import ClassMap, class_call, class_key, open_class_call
from sdm.engine.capacity.classes import MANY_EDGES, MOST_EDGES, CapacityClass, larger_classes
from sdm.engine.capacity.open_boundary import OpenBoundary
from sdm.kernels.dense.plan import Decisions, memory_of
from sdm.kernels.topology.boundary_loops import WRONG_EDGES, WRONG_UNMATCHED, WRONG_VERTEX
from sdm.runtime import graphs
from sdm.runtime.torch_warp import warp_name
from sdm.topology import guesses
from sdm.topology.cap_triangles import remember_joined
from sdm.topology.face_pairing import Pairing, remember, remember_closed

# Twice the vertices less the faces: of closed meshes 4 for each part, and 4 less for each handle. A mesh with more is
# more likely one with holes, whose edges add up to that, and so is one with another number than a multiple of 4.
MOST_OF_CLOSED = 12


def looks_closed(faces: int, vertices: int) -> bool:
    """True if a mesh of so many faces and vertices is more likely closed than not."""
    open_by = 2 * vertices - faces
    return open_by % 4 == 0 and open_by <= MOST_OF_CLOSED


def has_room(numbers: guesses.Guess) -> bool:
    """True if the recordings of a class serve meshes with as many unmatched and boundary edges."""
    return max(numbers) <= MANY_EDGES


def class_map(
    kind: CapacityClass, decisions: Decisions, vertices: Tensor, faces: Tensor, grid: Grid
) -> tuple[Tensor, Tensor | None] | None:
    """The map (nx,ny,nz) of a mesh of a class, and if it is open how many voxels are ambiguous (1,).

    None if there is no recording for it, or if it is none that these serve. Else its topology is remembered.
    """
    # What recordings read by address.
    given = vertices.contiguous(), faces.contiguous(), grid
    count, total, device = vertices.shape[0], faces.shape[0], faces.device
    # Until the launch no more than it takes.
    edges = min(2 * count - total, MANY_EDGES)
    if looks_closed(total, count):
        found, said = _attempt(class_call, kind, decisions, 0, given)
        if found is not None:
            remember_closed(faces, count, found.neighbours, graphs.last_launch(device))
            return found.values, None
        # Flags of `class_call`.
        if said and (said[0] or said[1]):
            return None
        if not said and not any(graphs.is_recorded(device, class_key(kind, room)) for room in kind.rooms(device.type)):
            # Neither is made for one that is not due.
            return None
        edges = said[2] if said else 0
    for room in kind.rooms(device.type):
        # A recording for many edges is made for meshes that have them.
        if edges > room or (edges <= MOST_EDGES < room):
            continue
        found, said = _attempt(partial(open_class_call, room=room), kind, decisions, room, given)
        if found is not None:
            return found.values, _remember(count, faces, found, room, *said[-2:])
        edges = max([room + 1, *said[-2:]]) if said else edges
        if said and (said[WRONG_VERTEX] or not (said[WRONG_UNMATCHED] or said[WRONG_EDGES])):
            return None
    return None


def _attempt(
    make: Any, kind: CapacityClass, decisions: Decisions, room: int, given: tuple[Tensor, Tensor, Grid]
) -> tuple[ClassMap | None, list[int]]:
    """Result of a class's recording; of that of a larger class, if there is one, until its own is worth the time."""

    def of_larger() -> Any:
        device = given[0].device
        for larger in larger_classes(kind, decisions, given[2], memory_of(warp_name(device))):
            if graphs.is_recorded(device, class_key(larger, room)):
                return make(larger, decisions, *given)
        return None

    return graphs.attempt_by_table(make(kind, decisions, *given, instead=of_larger))


def _remember(vertices: int, faces: Tensor, found: ClassMap, room: int, rows: int, edges: int) -> Tensor | None:
    """Remember the topology of faces that were just found open, and give the ambiguous voxels."""
    ready = graphs.last_launch(faces.device)
    if rows == 0 or found.unmatched is None or found.boundary is None:
        remember_closed(faces, vertices, found.neighbours, ready)
        return None
    pairing = Pairing(found.unmatched[:rows], found.neighbours, ready=ready)
    remember(faces, vertices, pairing)
    remember_joined(pairing, *OpenBoundary.joined(found.boundary, room, edges))
    guesses.remember_numbers(faces, vertices, guesses.Guess(rows, edges))
    return found.ambiguous if edges else None
