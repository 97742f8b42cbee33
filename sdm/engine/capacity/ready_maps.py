"""First maps by a recording that was used before: what is asked before the launch is as little as can be.

Until the first kernel is launched a GPU waits for the host, which is all memory that has left the processor's caches by
then: each function on the way costs some microseconds. So what is the same for all meshes of a class and a grid's shape
is looked up at once. Whatever is out of the ordinary goes the usual way, `sdm.engine.capacity.first_maps`, which does
the same.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar

import torch
from torch import Tensor

from sdm.core.grid import IDENTITY, Grid
from sdm.engine.capacity.class_calls import Told, class_key, fill_table, told_behind
from sdm.engine.capacity.classes import LARGEST, MANY_EDGES, MOST_EDGES, MOSTS, CapacityClass, is_of_all
from sdm.engine.capacity.remembered import finished, while_at_work
from sdm.engine.plan_override import OPTIONS, USUAL
from sdm.kernels.dense.plan import Decisions
from sdm.runtime import graphs
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


class _Ready(NamedTuple):
    """A class whose decisions are those of all its meshes, and its recordings by their room for edges."""

    kind: CapacityClass
    decisions: Decisions
    rooms: tuple[int, ...]
    recordings: dict[int, tuple[graphs.Kept, int]]


# By the GPU's number, the most faces of the class, and the grid's shape.
_ready: dict[tuple[int, int, tuple[int, int, int]], _Ready] = {}


def looks_closed(faces: int, vertices: int) -> bool:
    """True if a mesh of so many faces and vertices is more likely closed than not."""
    open_by = 2 * vertices - faces
    # Or it is nothing but boxes, of 8 vertices and 12 faces each.
    return open_by % 4 == 0 and (open_by <= MOST_OF_CLOSED or 3 * vertices == 2 * faces)


def note_ready(kind: CapacityClass, decisions: Decisions, device: torch.device, room: int) -> None:
    """Note the recording of a class, with room for so many edges, for the calls to come."""
    kept = graphs.kept(device, class_key(kind, room))
    # As `Tensor.get_device` tells it.
    key = -1 if device.index is None else device.index, kind.most, kind.shape
    ready = _ready.get(key)
    if kept is None or (ready is not None and ready.recordings.get(room) == (kept, told_behind(room))):
        return
    if not is_of_all(kind, decisions):
        return
    if ready is None or ready.kind is not kind:
        while len(_ready) >= MOST_KEPT:
            del _ready[next(iter(_ready))]
        ready = _ready[key] = _Ready(kind, decisions, kind.rooms(device.type), {})
    ready.recordings[room] = kept, told_behind(room)


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
    if ready is None or id(faces) in face_pairing.known or (total, count) in guesses.last_open:
        return None, None
    kind, decisions, rooms, recordings = ready
    room = 0
    if not looks_closed(total, count):
        edges = min(2 * count - total, MANY_EDGES)
        for room in rooms:
            if edges <= room and not edges <= MOST_EDGES < room:
                break
    recording = recordings.get(room)
    if recording is None or count > kind.vertices or OPTIONS.get() is not USUAL:
        return None, None
    if not (vertices.is_contiguous() and faces.is_contiguous()):
        return None, None
    kept, behind = recording

    def launched(filled: tuple[Tensor, Tensor]) -> Any:
        values, told = filled
        return while_at_work(faces, count, make, values, Told(told, total, room))

    about = kind, decisions, (vertices, faces, grid, count, total, faces.device), behind
    found, said = graphs.attempt_kept(kept, fill_table, about, (vertices, faces), launched)
    if found is not None:
        return finished(found, said), None
    return None, (room, said) if said else None
