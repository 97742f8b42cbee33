"""First maps of meshes by the recordings of their class: one for closed meshes, one for open ones.

Whether a mesh is closed is known once its faces are paired. Which recording is launched first, and made if there is
none, is a guess, by counts alone: the faces of a closed mesh are even in number, and as it has half as many edges
again, its vertices are half as many as its faces, and two more for each part, two less for each handle. A hole adds a
vertex for each two edges of its rim. The recording for open meshes serves closed ones too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Generic, NamedTuple, TypeVar

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.capacity.class_calls import Given, Told, class_call, class_key
from sdm.engine.capacity.classes import MANY_EDGES, MOST_EDGES, CapacityClass, larger_classes
from sdm.engine.capacity.open_boundary import OpenBoundary
from sdm.kernels.dense.plan import Decisions, memory_of
from sdm.kernels.topology.boundary_loops import WRONG_EDGES, WRONG_UNMATCHED, WRONG_VERTEX
from sdm.kernels.topology.edge_pairing import OUT_OF_RANGE, UNMATCHED
from sdm.runtime import graphs
from sdm.runtime.host_copy import number_later
from sdm.runtime.torch_warp import warp_name
from sdm.topology import guesses
from sdm.topology.cap_triangles import remember_joined
from sdm.topology.face_pairing import Pairing, closed_pairing, remember_later

# What is made of a map.
T = TypeVar("T")
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
    kind: CapacityClass,
    decisions: Decisions,
    vertices: Tensor,
    faces: Tensor,
    grid: Grid,
    make: Callable[[Tensor], T],
) -> tuple[T, Callable[[], int] | None] | None:
    """The map (nx,ny,nz) of a mesh of a class as `make` makes it, and if it is open a counter of its ambiguous voxels.

    None if there is no recording for it, or if it is none that these serve. Else its topology is remembered. `make` is
    called while the device is at work, and again if that turns out to have been in vain.
    """
    # What recordings read by address.
    count, total, device = vertices.shape[0], faces.shape[0], faces.device
    given = vertices.contiguous(), faces.contiguous(), grid, count, total, device
    # Until the launch no more than it takes.
    edges = min(2 * count - total, MANY_EDGES)

    def launched(values: Tensor, told: Told) -> _Found[T]:
        return _Found(make(values), told)

    about = kind, decisions, given
    if looks_closed(total, count):
        call = class_call(*about, 0, partial(_call_of_larger, *about, 0, launched), launched)
        found, said = graphs.attempt_by_table(call)
        if found is not None:
            remember_later(faces, count, partial(_closed_pairing, found.told, graphs.last_launch(device)))
            return found.made, None
        # Flags of `class_call`.
        if said and said[OUT_OF_RANGE]:
            return None
        if not said and not any(graphs.is_recorded(device, class_key(kind, room)) for room in kind.rooms(device.type)):
            # Neither is made for one that is not due.
            return None
        edges = said[UNMATCHED] if said else 0
    for room in kind.rooms(device.type):
        # A recording for many edges is made for meshes that have them.
        if edges > room or (edges <= MOST_EDGES < room):
            continue
        call = class_call(*about, room, partial(_call_of_larger, *about, room, launched), launched)
        found, said = graphs.attempt_by_table(call)
        if found is not None:
            return found.made, _remember_open(faces, count, found.told, *said[-2:])
        edges = max([room + 1, *said[-2:]]) if said else edges
        if said and (said[WRONG_VERTEX] or not (said[WRONG_UNMATCHED] or said[WRONG_EDGES])):
            return None
    return None


class _Found(NamedTuple, Generic[T]):
    """A map as it was made, and the topology that its mesh's faces have."""

    made: T
    told: Told


def _call_of_larger(
    kind: CapacityClass,
    decisions: Decisions,
    given: Given,
    room: int,
    launched: Callable[[Tensor, Told], Any],
) -> graphs.TableCall[Any] | None:
    """The call of a larger class, if there is a recording of one, until that of its own class is worth the time."""
    _, _, grid, _, _, device = given
    for larger in larger_classes(kind, decisions, grid, memory_of(warp_name(device))):
        if graphs.is_recorded(device, class_key(larger, room)):
            return class_call(larger, decisions, given, room, None, launched)
    return None


def _closed_pairing(told: Told, ready: torch.cuda.Event | None) -> Pairing:
    return closed_pairing(told.neighbours, ready)


def _remember_open(faces: Tensor, count: int, told: Told, rows: int, edges: int) -> Callable[[], int] | None:
    """Remember the topology of faces that were just found open, and give what counts the ambiguous voxels."""
    ready = graphs.last_launch(faces.device)
    if rows == 0:
        remember_later(faces, count, partial(_closed_pairing, told, ready))
        return None
    remember_later(faces, count, partial(_open_pairing, told, rows, edges, ready))
    guesses.remember_numbers(faces, count, guesses.Guess(rows, edges))
    return number_later(told.memory, told.last) if edges else None


def _open_pairing(told: Told, rows: int, edges: int, ready: torch.cuda.Event | None) -> Pairing:
    pairing = Pairing(told.unmatched[:rows], told.neighbours, ready=ready)
    remember_joined(pairing, *OpenBoundary.joined(told.boundary, told.room, edges))
    return pairing
