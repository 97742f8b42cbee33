"""First maps of meshes by the recordings of their class: one for closed meshes, one for open ones.

Whether a mesh is closed is known once its faces are paired. Which recording is launched first, and made if there is
none, is a guess, by counts alone: the faces of a closed mesh are even in number, and as it has half as many edges
again, its vertices are half as many as its faces, and two more for each part, two less for each handle. A hole adds a
vertex for each two edges of its rim. The recording for open meshes serves closed ones too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.engine.capacity.class_calls import Given, Told, class_call, class_key
from sdm.engine.capacity.classes import BY_FACES, LARGEST_ROOM, TOO_FEW, CapacityClass, larger_classes
from sdm.engine.capacity.ready_maps import Tried, looks_closed, note_ready
from sdm.engine.capacity.remembered import finished, while_at_work
from sdm.kernels.dense.plan import Decisions, memory_of
from sdm.kernels.topology.boundary_flags import WRONG_EDGES, WRONG_UNMATCHED, WRONG_VERTEX
from sdm.kernels.topology.edge_pairing import OUT_OF_RANGE, UNMATCHED
from sdm.runtime import graphs
from sdm.runtime.torch_warp import warp_name
from sdm.topology import guesses

# What is made of a map.
T = TypeVar("T")


def has_room(numbers: guesses.Guess) -> bool:
    """True if the recordings of a class serve meshes with as many unmatched and boundary edges."""
    return max(numbers) <= LARGEST_ROOM


def class_map(
    kind: CapacityClass,
    decisions: Decisions,
    vertices: Tensor,
    faces: Tensor,
    grid: Grid,
    make: Callable[[Tensor], T],
    tried: Tried | None = None,
) -> tuple[T, Callable[[], int] | None] | None:
    """The map (nx,ny,nz) of a mesh of a class as `make` makes it, and if it is open a counter of its ambiguous voxels.

    None if there is no recording for it, or if it is none that these serve. Else its topology is remembered. `make` is
    called while the device is at work, and again if that turns out to have been in vain. `tried`: what was found to be
    in vain before, by `ready_map`.
    """
    # What recordings read by address.
    count, total, device = vertices.shape[0], faces.shape[0], faces.device
    given: Given = vertices.contiguous(), faces.contiguous(), grid, count, total, device
    about = kind, decisions, given
    last = guesses.last_numbers(faces, count) or guesses.CLOSED
    edges = min(2 * count - total if last is guesses.CLOSED else max(last), LARGEST_ROOM)

    def attempt(room: int) -> tuple[T, Callable[[], int] | None] | list[int]:
        launched = partial(while_at_work, faces, count, make)
        instead = partial(_call_of_larger, *about, room, launched)
        found, said = graphs.attempt_by_table(class_call(*about, room, instead, launched))
        if found is None:
            return said
        note_ready(kind, device, room, larger_classes(kind, decisions, grid, memory_of(warp_name(device))))
        return finished(found, said)

    if tried is None and looks_closed(total, count):
        found = attempt(0)
        if isinstance(found, tuple):
            return found
        if not found and not any(graphs.is_recorded(device, class_key(kind, room)) for room in kind.rooms(device.type)):
            # Neither is made for one that is not due.
            return None
        tried = 0, found
    tested = -1
    if tried is not None:
        tested, said = tried
        more = _edges_told(tested, said)
        if more is None:
            return None
        edges = max(edges, more) if tested else more
    for room in _rooms(kind, device, total, edges, tested):
        if room <= tested or not TOO_FEW.get(room, -1) < edges <= room:
            continue
        found = attempt(room)
        if isinstance(found, tuple):
            return found
        more = _edges_told(room, found)
        if more is None:
            return None
        edges = max(edges, more)
    return None


def _rooms(kind: CapacityClass, device: torch.device, faces: int, edges: int, tested: int) -> tuple[int, ...]:
    """Rooms for edges of the recordings that may serve a mesh with so many unmatched ones, from the least on."""
    if tested == 0 and faces < 2 * edges <= BY_FACES[-1]:
        # Its vertices are shared, or it would not have looked closed: so these are edges of two faces that do not
        # agree, each of which counts twice.
        return tuple(room for room in BY_FACES if 2 * edges <= room)
    return kind.rooms(device.type)


def _edges_told(room: int, said: list[int]) -> int | None:
    """Edges that the next recording needs room for, after one told that it does not serve; None if none does."""
    if not said:
        return 0
    if room == 0:
        # Flags of `class_call`.
        return None if said[OUT_OF_RANGE] else said[UNMATCHED]
    if said[WRONG_VERTEX] or not (said[WRONG_UNMATCHED] or said[WRONG_EDGES]):
        return None
    return max(room + 1, *said[-2:])


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
