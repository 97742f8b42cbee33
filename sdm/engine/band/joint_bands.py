"""Bands of lists of meshes on a GPU: queued one after the other, and read together.

Of one band the host has to know three things before it can go on: whether the mesh is closed, how many blocks may be
near it, and how many are kept. Of many it asks for each of these once, while the device has the next one's work.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from sdm.core.block_lookup import blocks_along
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.band.band_slab import BandSlab
from sdm.engine.band.block_distances import (
    BandBlocks,
    Gathered,
    Layers,
    counted,
    queue_gather,
    queue_measure,
    refuse_too_many,
)
from sdm.engine.band.listed_blocks import (
    MOST_BLOCKS,
    Listed,
    Room,
    fits,
    has_bits,
    is_beyond,
    narrowed,
    queue_list,
    room_for_all,
)
from sdm.engine.band.near_blocks import rooms_of
from sdm.engine.mesh_index import MeshIndex
from sdm.engine.repeated_faces import CROWDED
from sdm.kernels.band.block_bits import BLOCKS, COUNTS
from sdm.runtime.torch_warp import on_current_stream
from sdm.topology.face_pairing import PairingUnderWay, is_known, remember

# Devices where lists pay: a CPU waits for nothing.
DEVICES = ("cuda",)
# Of meshes whose lists are made before any is read: how many, their triangles, and blocks that there is room for.
MOST_MESHES, MOST_TRIANGLES, MOST_ROOM = 64, 1 << 22, 1 << 25
# Blocks that are measured before their counts are read.
MOST_MEASURED = 1 << 18


class Asked(NamedTuple):
    """A mesh, on its device, the grid of its band, and how far that reaches in the mesh's unit."""

    mesh: TriangleMesh
    grid: Grid
    width: float


class JointBand(NamedTuple):
    """The band of a closed mesh, and the mesh's index."""

    index: MeshIndex
    found: BandBlocks


class _Begun(NamedTuple):
    """A band whose lists are queued."""

    place: int
    index: MeshIndex
    band: BandSlab
    room: Room
    listed: Listed


class _Measured(NamedTuple):
    """A band that is queued, whose counts are still to be read."""

    place: int
    index: MeshIndex
    gathered: Gathered
    counts: Tensor
    beyond: bool


def joint_bands(asked: Sequence[Asked]) -> Iterator[tuple[int, JointBand | None]]:
    """The bands of closed meshes with a sign, with their places; None where a call of its own has to make it.

    All meshes are on one device. To be taken one after the other: those that are not taken yet are not all made.

    Raises:
        MeshError: A face index out of range.
        GridError: A band that does not fit into memory.
    """
    for group in _groups(asked):
        _pair_up([asked[place].mesh for place in group])
        begun, left = [], []
        for place in group:
            one = _begin(place, asked[place])
            if one is None:
                left.append(place)
            else:
                begun.append(one)
        yield from ((place, None) for place in left)
        yield from _settled(begun)


def _groups(asked: Sequence[Asked]) -> Iterator[list[int]]:
    group: list[int] = []
    room = triangles = 0
    for place, one in enumerate(asked):
        more, faces = min(math.prod(blocks_along(one.grid.shape)), MOST_BLOCKS), len(one.mesh)
        full = len(group) == MOST_MESHES or triangles + faces > MOST_TRIANGLES
        if group and (full or room + more > MOST_ROOM):
            yield group
            group, room, triangles = [], 0, 0
        group.append(place)
        room, triangles = room + more, triangles + faces
    if group:
        yield group


def _pair_up(meshes: Sequence[TriangleMesh]) -> None:
    """Find out which faces meet, of all meshes before any is waited for."""
    new = [mesh for mesh in meshes if not is_known(mesh.faces, len(mesh.vertices))]
    under_way = [PairingUnderWay(mesh.faces.contiguous(), len(mesh.vertices)) for mesh in new]
    for mesh, pairing in zip(new, under_way, strict=True):
        remember(mesh.faces, len(mesh.vertices), pairing.finish())


def _begin(place: int, asked: Asked) -> _Begun | None:
    """Queue the lists of one band."""
    mesh, grid, width = asked
    if len(mesh) >= CROWDED * len(mesh.vertices):
        return None
    index = MeshIndex(mesh, mesh.device)
    if not index.closed or index._repeated is not None:
        return None
    plain = TriangleMesh(mesh.vertices.detach().contiguous(), mesh.faces.contiguous(), mesh.name, check=False)
    structure = index._structure
    band = BandSlab(structure, grid, width, (0, grid.shape[0]), signed=True, mesh=plain)
    if not has_bits(band):
        return None
    room = room_for_all(band)
    with on_current_stream(plain.vertices, *structure.memory, plain.vertices, plain.faces):
        return _Begun(place, index, band, room, queue_list(band, room))


def _settled(begun: Sequence[_Begun]) -> Iterator[tuple[int, JointBand | None]]:
    """The bands of what was begun, measured as many at a time as there is room for."""
    waiting: list[_Measured] = []
    blocks = 0
    for one, counts in zip(begun, _read([one.listed.counts for one in begun]), strict=True):
        device = one.band.structure.device
        refuse_too_many(counts[BLOCKS], device)
        listed = counts[BLOCKS]
        if not 0 < listed <= MOST_BLOCKS or not fits(counts, one.room, rooms_of(one.band.shape, device)):
            yield one.place, None
            continue
        if waiting and blocks + listed > MOST_MEASURED:
            yield from _taken(waiting)
            waiting, blocks = [], 0
        waiting.append(_measure(one, counts))
        blocks += listed
    yield from _taken(waiting)


def _measure(begun: _Begun, counts: list[int]) -> _Measured:
    """Queue the measuring of one band, and the copy of what is kept."""
    beyond = is_beyond(counts, begun.band.whole)
    band = replace(begun.band, beyond=beyond)
    with on_current_stream(begun.listed.blocks, *band.structure.memory):
        listed = narrowed(band, begun.listed, counts)
        measured = queue_measure(band, listed, gaps=True)
        layers, room = Layers(band.shape, 0, band.width), (len(listed.blocks), len(measured.runs))
        gathered = queue_gather(layers, listed.blocks, measured, listed.counts, *room)
    # What was measured is let go: the next band's is put into its memory, after the copy.
    return _Measured(begun.place, begun.index, gathered, listed.counts[:COUNTS], beyond)


def _taken(waiting: Sequence[_Measured]) -> Iterator[tuple[int, JointBand]]:
    said = _read([one.counts for one in waiting])
    for one, counts in zip(waiting, said, strict=True):
        yield one.place, JointBand(one.index, counted(one.gathered, counts)._replace(beyond=one.beyond))


def _read(counts: Sequence[Tensor]) -> list[list[int]]:
    """Numbers of several tensors, by one wait."""
    if not counts:
        return []
    numbers, begin, found = torch.cat(list(counts)).tolist(), 0, []
    for one in counts:
        found.append(numbers[begin : begin + len(one)])
        begin += len(one)
    return found
