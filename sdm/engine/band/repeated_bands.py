"""Bands of closed meshes of a kind that comes again: recorded as CUDA graphs, build and all, and read once.

How many blocks there are is known only on the device. So a recording has room for an eighth more than the last band of
its kind had, and what it found is copied from there once the host has read how much it is. If the mesh turns out to be
open, to reach beyond the grid, or to have more blocks, the band is made anew, step by step.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Hashable
from functools import partial

import torch
import warp as wp
from torch import Tensor

from sdm.core.block_lookup import blocks_along
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.acceleration import AccelerationStructure, MeshKind, Sizes, fill_surface, layout
from sdm.engine.band.band_slab import BandSlab, plan_for
from sdm.engine.band.block_distances import (
    LISTS,
    BandBlocks,
    Layers,
    Measured,
    gather_early,
    queue_measure,
    taken,
)
from sdm.engine.band.listed_blocks import Listed, Room, fits, is_beyond, queue_list
from sdm.engine.band.near_blocks import BLOCK_BYTES, marks_by_triangles, rooms_of
from sdm.engine.plan_override import OPTIONS
from sdm.engine.repeated_faces import CROWDED
from sdm.engine.thick_slices import Slices
from sdm.kernels.band.query import bytes_for
from sdm.kernels.dense.plan import Plan, memory_of
from sdm.kernels.topology.edge_pairing import FLAGS
from sdm.runtime import graphs
from sdm.runtime.graphs import Call, Verify
from sdm.runtime.graphs.branches import Join, beside, kernels_beside
from sdm.runtime.host_copy import numbers_of
from sdm.runtime.torch_warp import as_warp, on_current_stream, warp_name
from sdm.topology.face_pairing import queue_pairing

# A recording may take this part of its device's memory: larger ones would drive others out, and save less.
SHARE = 64
# Kinds that are remembered, and room beside an eighth more than was needed.
MOST_KEPT, ROOM = 64, 64
_rooms: OrderedDict[Hashable, Room] = OrderedDict()


def is_recordable(mesh: TriangleMesh) -> bool:
    """True if bands of this mesh, which is on its device, may be recorded and replayed."""
    # Of many copies of a face the sign is not found here.
    return graphs.supports(mesh.vertices) and len(mesh) < CROWDED * len(mesh.vertices)


def replayed(mesh: TriangleMesh, grid: Grid, width: float) -> BandBlocks | None:
    """The band of a recordable mesh, if one of its kind was recorded, and it is as the last of its kind was."""
    room = _rooms.get(_kind(mesh, grid, width))
    if room is None:
        return None
    found, guessed_right = graphs.speculate(band_call(mesh, grid, width, room), lambda: ((), None))
    if not guessed_right:
        return None
    blocks, values, runs = found
    return BandBlocks(blocks, values, 0, runs)


def note(mesh: TriangleMesh, grid: Grid, width: float, found: BandBlocks) -> None:
    """Count a band of a recordable mesh that is closed and was made step by step, to be recorded if it comes often."""
    needed, kind = found.room, _kind(mesh, grid, width)
    if needed is None or needed.chunks is None or found.beyond or needed.blocks == 0:
        return
    plan = plan_for(len(mesh), Slices(grid.spacing, grid.shape, 0), grid, mesh.device)
    wanted, room = room_for(needed, plan, grid), _rooms.pop(kind, None)
    if room is None or not _is_about(room, needed, wanted):
        room = wanted
    _rooms[kind] = room
    while len(_rooms) > MOST_KEPT:
        _rooms.popitem(last=False)
    lists = bytes_for(plan, room.regions, len(mesh), room.chunks or 0)
    nbytes = room.blocks * BLOCK_BYTES + layout(_sizes(len(mesh)))[0] + lists
    if plan.method == "cells" and nbytes <= (memory_of(warp_name(mesh.device)) or 0) // SHARE:
        graphs.note(band_call(mesh, grid, width, room))


def room_for(needed: Room, plan: Plan, grid: Grid) -> Room:
    """Room for a band that needs about as much: a little more, and no more than there can be."""
    blocks = min(_more(needed.blocks), math.prod(blocks_along(grid.shape)))
    regions = min(_more(needed.regions), plan.total)
    # Each region, and each cell, has its first chunks, needed or not.
    reserved = (regions - needed.regions) * (plan.region_shares + 8 * plan.cell_shares)
    return Room(blocks, regions, _more(needed.chunks or 0) + max(0, reserved))


def _more(needed: int) -> int:
    return needed + needed // 8 + ROOM


def _is_about(room: Room, needed: Room, wanted: Room) -> bool:
    """True if room has as much as is needed, and not much more than is wanted."""
    enough = room.blocks >= needed.blocks and room.regions >= needed.regions
    enough = enough and (room.chunks or 0) >= (wanted.chunks or 0) - (needed.chunks or 0) // 8
    return enough and room.blocks <= 2 * wanted.blocks and (room.chunks or 0) <= 2 * (wanted.chunks or 0)


def _kind(mesh: TriangleMesh, grid: Grid, width: float) -> Hashable:
    return mesh.device, len(mesh.vertices), len(mesh), grid, width, OPTIONS.get()


def _sizes(faces: int) -> Sizes:
    return Sizes(1, faces, 0, MeshKind.CLOSED)


def band_call(mesh: TriangleMesh, grid: Grid, width: float, room: Room) -> Call:
    """The call that makes the blocks (N,3), values (N,8,8,8) and runs (R,4) of a band, if nothing is as not guessed."""
    key = "band", _kind(mesh, grid, width), room
    inputs = mesh.vertices.detach().contiguous(), mesh.faces.contiguous()
    work = partial(queue_band, grid, width, room)
    return Call(key, work, inputs, partial(finish_band, grid, width, room))


def queue_band(
    grid: Grid, width: float, room: Room, verify: Verify, vertices: Tensor, faces: Tensor
) -> tuple[Tensor, ...]:
    """Numbers, the blocks that may be near, and what was measured of them, all with room: see `finish_band`."""
    # The kernels after this trust the faces, which only later turn out to be out of range.
    within = faces.clamp(0, vertices.shape[0] - 1)
    with beside(faces.device) as join:
        flags, _, neighbours = queue_pairing(faces, vertices.shape[0])
    structure = AccelerationStructure.in_block(_sizes(faces.shape[0]), vertices.device)
    band = BandSlab(structure, grid, width, (0, grid.shape[0]), signed=True)
    bounds = torch.empty(6, dtype=torch.float32, device=vertices.device)
    lists: list[tuple[Listed, Join]] = []
    unjoined: list[Join] = []

    def join_surface() -> None:
        for each in unjoined:
            each()

    def list_blocks() -> None:
        # Beside the rest of the build, where triangles mark their blocks.
        with kernels_beside(vertices, LISTS) as join_lists:
            lists.append((queue_list(band, room), join_lists))

    early = marks_by_triangles(band.slab, vertices.device)
    with on_current_stream(vertices, vertices, within, neighbours):
        fill_surface(
            structure.view,
            vertices[None],
            within,
            neighbours,
            as_warp(bounds, wp.float32),
            join,
            gathered=list_blocks if early else None,
            unjoined=unjoined,
        )
        if not early:
            list_blocks()
        ((listed, join_lists),) = lists
        join_lists()
        measured = queue_measure(band, listed, gaps=True, chunks=room.chunks, join_surface=join_surface)
    numbers = torch.cat([flags, listed.counts[: -len(bounds)], bounds.view(torch.int32)])
    return numbers, listed.blocks, *measured


def finish_band(grid: Grid, width: float, room: Room, made: tuple[Tensor, ...]) -> tuple[Tensor, ...] | None:
    """The band of what `queue_band` made, in memory of its own; None if that was guessed wrong. Waits once."""
    numbers, blocks, *rest = made
    measured, layers, numbered = Measured(*rest), Layers(grid.shape, 0, width), numbers[FLAGS:]
    with on_current_stream(blocks):
        wait = numbers_of(numbers)
        early, boxes = gather_early(layers, blocks, measured, numbered), rooms_of(grid.shape, blocks.device)
        said = wait()
        counts = said[FLAGS:]
        if any(said[:FLAGS]) or not fits(counts, room, boxes):
            return None
        if is_beyond(counts, grid, minus=False):
            return None
        found = taken(layers, blocks, measured, numbered, counts, early)
    return found[:2] if found.runs is None else (found.blocks, found.values, found.runs)
