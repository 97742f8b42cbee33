"""Topology of meshes whose first maps were made by the recordings of a class: remembered as these told it.

All that can be done while the device is at work is: behind what the host waits for little is left.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Generic, NamedTuple, TypeVar

import torch
from torch import Tensor

from sdm.engine.capacity.class_calls import Told
from sdm.engine.capacity.classes import BY_FACES
from sdm.engine.capacity.open_boundary import OpenBoundary
from sdm.runtime import graphs
from sdm.runtime.host_copy import number_later
from sdm.topology import guesses
from sdm.topology.cap_triangles import remember_joined
from sdm.topology.face_pairing import Noted, Pairing, closed_pairing, noted, remember_noted

# What is made of a map.
T = TypeVar("T")


class Found(NamedTuple, Generic[T]):
    """A map as it was made, and what will be remembered if it serves.

    Args:
        made: The map.
        told: What its mesh's faces say.
        faces: Of the mesh.
        count: Of its vertices.
        note: Of its faces, see `face_pairing.noted`.
        ready: Event after the launch.
        counter: Of the map's ambiguous voxels, if the mesh is open.
    """

    made: T
    told: Told
    faces: Tensor
    count: int
    note: Noted
    ready: torch.cuda.Event | None
    counter: Callable[[], int] | None


def while_at_work(faces: Tensor, count: int, make: Callable[[Tensor], T], values: Tensor, told: Told) -> Found[T]:
    """The part of the work on a map (nx,ny,nz) that can be done before it is known whether the recording serves."""
    counter = number_later(told.memory, told.last) if told.room else None
    return Found(make(values), told, faces, count, noted(faces, count), graphs.last_launch(faces.device), counter)


def finished(found: Found[T], said: list[int]) -> tuple[T, Callable[[], int] | None]:
    """The map, and a counter of its ambiguous voxels if it is open; its faces are remembered.

    `said`: what the recording told the host.
    """
    made, told, faces, count, note, ready, counter = found
    rows, edges = said[-2:] if told.room else (0, 0)
    if rows == 0:
        remember_noted(note, partial(_closed_pairing, told, ready))
        return made, None
    remember_noted(note, partial(_open_pairing, told, rows, edges, ready))
    guesses.remember_numbers(faces, count, guesses.Guess(rows, edges))
    return made, counter if edges else None


def _closed_pairing(told: Told, ready: torch.cuda.Event | None) -> Pairing:
    return closed_pairing(told.neighbours, ready)


def _open_pairing(told: Told, rows: int, edges: int, ready: torch.cuda.Event | None) -> Pairing:
    pairing = Pairing(told.unmatched[:rows], told.neighbours, ready=ready)
    found, caps = OpenBoundary.joined(told.boundary, told.room, edges)
    if told.room in BY_FACES:
        pairing.edges = found
    else:
        remember_joined(pairing, found, caps)
    return pairing
