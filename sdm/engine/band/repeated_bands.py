"""Bands of meshes of a kind that comes again: recorded as CUDA graphs, build and all, and read once.

How many blocks there are is known only on the device. So a recording has room for an eighth more than the last band of
its kind had, and what it found is copied from there once the host has read how much it is. Open meshes are guessed to
have as many boundary edges as the last. If a mesh turns out to have others, to reach beyond the grid, or to have more
blocks, the band is made anew, step by step.
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
from sdm.engine.acceleration import AccelerationStructure, Sizes, fill_boundary, fill_surface, kind_of, layout
from sdm.engine.band.band_slab import BandSlab, plan_for
from sdm.engine.band.block_distances import (
    BLOCK_BYTES,
    LISTS,
    BandBlocks,
    Layers,
    Measured,
    can_list_gaps,
    gather_early,
    queue_measure,
    taken,
)
from sdm.engine.band.listed_blocks import Listed, Room, fits, is_beyond, queue_list
from sdm.engine.band.near_blocks import marks_by_triangles, rooms_of
from sdm.engine.plan_override import OPTIONS
from sdm.engine.repeated_faces import CROWDED
from sdm.engine.thick_slices import Slices
from sdm.kernels.band.query import bytes_for
from sdm.kernels.dense.plan import Plan, memory_of
from sdm.kernels.topology import boundary_loops
from sdm.kernels.topology.edge_pairing import FLAGS
from sdm.runtime import graphs
from sdm.runtime.graphs import Call, Verify
from sdm.runtime.graphs.branches import Join, beside, kernels_beside
from sdm.runtime.host_copy import numbers_of
from sdm.runtime.torch_warp import as_warp, on_current_stream, warp_name
from sdm.topology import guesses
from sdm.topology.face_pairing import pairing_of
from sdm.topology.guesses import Guess

# A recording may take this part of its device's memory: larger ones would drive others out, and save less.
SHARE = 64
# Kinds that are remembered, and room beside an eighth more than was needed.
MOST_KEPT, ROOM = 64, 64
_known: OrderedDict[Hashable, tuple[Room, Guess]] = OrderedDict()


def is_recordable(mesh: TriangleMesh) -> bool:
    """True if bands of this mesh, which is on its device, may be recorded and replayed."""
    # Of many copies of a face the sign is not found here.
    return graphs.supports(mesh.vertices) and len(mesh) < CROWDED * len(mesh.vertices)


def replayed(mesh: TriangleMesh, grid: Grid, width: float) -> BandBlocks | None:
    """The band of a recordable mesh, if one of its kind was recorded, and it is as the last of its kind was."""
    known = _known.get(_kind(mesh, grid, width))
    if known is None:
        return None
    found, guessed_right = graphs.speculate(band_call(mesh, grid, width, *known), lambda: ((), None))
    if not guessed_right:
        return None
    blocks, values, runs, *ambiguous = found
    return BandBlocks(blocks, values, int(ambiguous[0]) if ambiguous else 0, runs)


def note(mesh: TriangleMesh, grid: Grid, width: float, found: BandBlocks, edges: Tensor) -> None:
    """Count a band of a recordable mesh that was made step by step, to be recorded if such bands come often.

    `edges` (E,2): its boundary edges.
    """
    needed, kind, guessed = found.room, _kind(mesh, grid, width), _guess_for(mesh, edges)
    if guessed is None or needed is None or needed.chunks is None or found.beyond or needed.blocks == 0:
        return
    plan = plan_for(len(mesh), Slices(grid.spacing, grid.shape, 0), grid, mesh.device)
    wanted, (room, _) = room_for(needed, plan, grid), _known.pop(kind, (None, guessed))
    if room is None or not _is_about(room, needed, wanted):
        room = wanted
    _known[kind] = room, guessed
    while len(_known) > MOST_KEPT:
        _known.popitem(last=False)
    lists = bytes_for(plan, room.regions, len(mesh), room.chunks or 0)
    nbytes = room.blocks * BLOCK_BYTES + layout(_sizes(len(mesh), guessed))[0] + lists
    if plan.method == "cells" and nbytes <= (memory_of(warp_name(mesh.device)) or 0) // SHARE:
        graphs.note(band_call(mesh, grid, width, room, guessed))


def _guess_for(mesh: TriangleMesh, edges: Tensor) -> Guess | None:
    """The topology that the next mesh of a kind is guessed to have; None where the device would not find it."""
    faces, count = mesh.faces, len(mesh.vertices)
    unmatched = pairing_of(faces, count).unmatched.shape[0]
    if unmatched == 0:
        return guesses.CLOSED
    if edges.shape[0] == 0 or not can_list_gaps(kind_of(edges.shape[0], len(mesh))):
        return None
    guesses.remember(faces, count, edges)
    return None if guesses.is_hopeless(faces, count) else guesses.last_numbers(faces, count)


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


def _sizes(faces: int, guessed: Guess) -> Sizes:
    return Sizes(1, faces, guessed.boundary, kind_of(guessed.boundary, faces))


def band_call(mesh: TriangleMesh, grid: Grid, width: float, room: Room, guessed: Guess = guesses.CLOSED) -> Call:
    """The call that makes the blocks (N,3), values (N,8,8,8) and runs (R,4) of a band, if nothing is as not guessed.

    Of an open mesh also the number of ambiguous voxels (), on the host.
    """
    key = "band", _kind(mesh, grid, width), room, guessed
    inputs = mesh.vertices.detach().contiguous(), mesh.faces.contiguous()
    work = partial(queue_band, grid, width, room, guessed)
    return Call(key, work, inputs, partial(finish_band, grid, width, room, guessed))


def queue_band(
    grid: Grid, width: float, room: Room, guessed: Guess, verify: Verify, vertices: Tensor, faces: Tensor
) -> tuple[Tensor, ...]:
    """Numbers, the blocks that may be near, and what was measured of them, all with room: see `finish_band`."""
    # The kernels after this trust the faces, which only later turn out to be out of range.
    within = faces.clamp(0, vertices.shape[0] - 1)
    flags: list[Tensor] = []
    with beside(faces.device) as join:
        topology = guesses.queue_guessed(guessed, vertices, faces, lambda found, told=0: flags.append(found))
    structure = AccelerationStructure.in_block(_sizes(faces.shape[0], guessed), vertices.device)
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

    # Those near the caps of an open mesh are listed too, which are made from its boundary.
    early = marks_by_triangles(band.slab, vertices.device) and guessed == guesses.CLOSED
    with on_current_stream(vertices, vertices, within, *topology):
        box = as_warp(bounds, wp.float32)
        fill_surface(
            structure.view,
            vertices[None],
            within,
            topology.neighbours,
            box,
            join,
            gathered=list_blocks if early else None,
            unjoined=unjoined,
        )
        if not early:
            fill_boundary(structure, vertices[None], topology, box, for_maps=True)
            list_blocks()
        ((listed, join_lists),) = lists
        join_lists()
        measured = queue_measure(band, listed, gaps=True, chunks=room.chunks, join_surface=join_surface)
    numbers = torch.cat([*flags, listed.counts[: -len(bounds)], bounds.view(torch.int32)])
    return numbers, listed.blocks, *measured


def finish_band(
    grid: Grid, width: float, room: Room, guessed: Guess, made: tuple[Tensor, ...]
) -> tuple[Tensor, ...] | None:
    """The band of what `queue_band` made, in memory of its own; None if that was guessed wrong. Waits once."""
    numbers, blocks, *rest = made
    flags = FLAGS if guessed == guesses.CLOSED else boundary_loops.FLAGS
    measured, layers, numbered = Measured(*rest), Layers(grid.shape, 0, width), numbers[flags:]
    with on_current_stream(blocks):
        wait = numbers_of(numbers)
        early, boxes = gather_early(layers, blocks, measured, numbered), rooms_of(grid.shape, blocks.device)
        said = wait()
        counts = said[flags:]
        if any(said[:flags]) or not fits(counts, room, boxes):
            return None
        if is_beyond(counts, grid, minus=False):
            return None
        found = taken(layers, blocks, measured, numbered, counts, early)
    if found.runs is None:
        return None
    band = found.blocks, found.values, found.runs
    return band if guessed == guesses.CLOSED else (*band, torch.tensor(found.ambiguous, device="cpu"))
