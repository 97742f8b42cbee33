"""First maps by a recording that was used before: what is asked before the launch is as little as can be.

Until the first kernel is launched a GPU waits for the host, which is all memory that has left the processor's caches by
then: each function on the way costs some microseconds. So what is the same for all meshes of a class and a grid's shape
is looked up at once. Whatever is out of the ordinary goes the usual way, `sdm.engine.capacity.first_maps`, which does
the same.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeAlias, TypeVar

import torch
from torch import Tensor

from sdm.core.grid import IDENTITY, Grid
from sdm.engine.capacity.class_calls import Told, class_key, fill_table, told_behind
from sdm.engine.capacity.classes import (
    LARGEST,
    LARGEST_ROOM,
    MOSTS,
    TOO_FEW,
    CapacityClass,
    has_room_for,
    is_usual,
    stretches,
)
from sdm.engine.capacity.remembered import finished, while_at_work
from sdm.engine.plan_override import OPTIONS, USUAL
from sdm.kernels.dense.plan import Decisions, memory_of
from sdm.runtime import graphs
from sdm.runtime.torch_warp import warp_name
from sdm.topology import face_pairing, guesses

# What is made of a map.
T = TypeVar("T")
# What a recording told that does not serve a mesh, and which: the room of that, 0 for closed meshes.
Tried: TypeAlias = tuple[int, list[int]]
# Twice the vertices less the faces: of closed meshes 4 for each part, and 4 less for each handle. A mesh with more is
# more likely one with holes, whose edges add up to that, and so is one with another number than a multiple of 4.
MOST_OF_CLOSED = 12
# Kinds of meshes and grids that are remembered.
MOST_KEPT = 256


class _Recording(NamedTuple):
    """A recording for meshes of a class: its own, or until that is worth the time that of a larger one."""

    kept: graphs.Kept
    kind: CapacityClass
    behind: int  # see `told_behind`
    left: list[int]  # of a larger one, calls before one looks whether the class is due


class _Ready(NamedTuple):
    """Recordings for the meshes of a class by their room for edges, and what is decided about these meshes."""

    most: list[int]  # faces of each stretch of `stretches`
    decisions: list[Decisions]
    rooms: tuple[int, ...]
    recordings: dict[int, _Recording]


# By the GPU's number, the most faces of the class, and the grid's shape.
_ready: dict[tuple[int, int, tuple[int, int, int]], _Ready] = {}


def looks_closed(faces: int, vertices: int) -> bool:
    """True if a mesh of so many faces and vertices is more likely closed than not."""
    open_by = 2 * vertices - faces
    # Or it is nothing but boxes, of 8 vertices and 12 faces each.
    return open_by % 4 == 0 and (open_by <= MOST_OF_CLOSED or 3 * vertices == 2 * faces)


def note_ready(kind: CapacityClass, device: torch.device, room: int, larger: Iterable[CapacityClass]) -> None:
    """Note the recording that served a class, with room for so many edges, for the calls to come.

    It is that of the class, or if there is none of the first of `larger` that there is.
    """
    # As `Tensor.get_device` tells it.
    key = -1 if device.index is None else device.index, kind.most, kind.shape
    ready = _ready.get(key)
    kept, by = graphs.kept(device, class_key(kind, room)), kind
    known = None if ready is None else ready.recordings.get(room)
    # A larger one is not noted again, so that the class is due one day.
    if known is not None and known.kept.recording is not None and (kept is None or known.kept is kept):
        return
    if kept is None:
        found = ((graphs.kept(device, class_key(one, room)), one) for one in larger if has_room_for(one, kind))
        kept, by = next(((kept, one) for kept, one in found if kept is not None), (None, kind))
    if kept is None or not is_usual(kind, memory_of(warp_name(device))):
        return
    if ready is None:
        while len(_ready) >= MOST_KEPT:
            del _ready[next(iter(_ready))]
        parts = stretches(kind.most, kind.shape, device.type == "cuda")
        ready = _ready[key] = _Ready(*parts, kind.rooms(device.type), {})
    left = [] if by is kind else [graphs.PATIENCE]
    ready.recordings[room] = _Recording(kept, by, told_behind(room), left)


def ready_map(
    vertices: Tensor, faces: Tensor, grid: Grid, index: int, make: Callable[[Tensor], T]
) -> tuple[tuple[T, Callable[[], int] | None] | None, Tried | None]:
    """The map (nx,ny,nz) of a mesh on the current GPU, and a counter, as by `first_maps.class_map`, if all is ready.

    Else None, and what was found to be in vain, if anything was. `vertices` and `faces` are plain tensors without
    gradients; `index` is the GPU's number.
    """
    count, total = vertices.shape[0], faces.shape[0]
    x, y, z = grid.spacing
    if not 0 < total <= LARGEST or grid.direction is not IDENTITY or not x == y == z:
        return None, None
    ready = _ready.get((index, MOSTS[bisect_left(MOSTS, total)], grid.shape))
    last = guesses.last_open.get((total, count), guesses.CLOSED)
    if ready is None or last is None or id(faces) in face_pairing.known:
        return None, None
    most, every, rooms, recordings = ready
    room = 0
    if last is not guesses.CLOSED or not looks_closed(total, count):
        edges = min(2 * count - total, LARGEST_ROOM) if last is guesses.CLOSED else max(last)
        if edges > min(total, LARGEST_ROOM):
            # None has room, or the faces would be fewer caps.
            return None, None
        for room in rooms:
            if TOO_FEW.get(room, -1) < edges <= room:
                break
    recording = recordings.get(room)
    if recording is None or OPTIONS.get() is not USUAL:
        return None, None
    kept, kind, behind, left = recording
    decisions = every[bisect_left(most, total)]
    if left:
        left[0] -= 1
    fits = count <= kind.vertices and decisions.cell == kind.plan.cell and decisions.method == "cells"
    if not (fits and vertices.is_contiguous() and faces.is_contiguous()) or (left and left[0] < 0):
        return None, None

    def launched(filled: tuple[Tensor, Tensor]) -> Any:
        values, told = filled
        return while_at_work(faces, count, make, values, Told(told, total, room))

    about = kind, decisions, (vertices, faces, grid, count, total, faces.device), behind
    found, said = graphs.attempt_kept(kept, fill_table, about, (vertices, faces), launched)
    if found is not None:
        return finished(found, said), None
    return None, (room, said) if said else None
