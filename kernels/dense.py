"""Queries at every voxel of a slab of a grid: the plain path, one nearest-triangle search a voxel.

The winding number goes first, into the array of values itself; the distances then replace it, with their sign.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.boundary import boundary_winding
from sdm.kernels.closest import nearest_slot
from sdm.kernels.crossings import covers, crossing_x
from sdm.kernels.geometry import closest_point
from sdm.kernels.points import CLOSED, SOUP, Winding
from sdm.kernels.solid_angle import soup_winding
from sdm.kernels.tree import FRAME_SIZE, LATTICE_SLACK, SCALE, UNSCALE, Tree, to_lattice

wp.set_module_options({"enable_backward": False})

_FRAME_SIZE = wp.constant(FRAME_SIZE)
_SCALE = wp.constant(SCALE)
_UNSCALE = wp.constant(UNSCALE)
_SOUP = wp.constant(SOUP)
# Voxels along z that one thread takes one after the other, and the tile of (x,y) that neighbouring threads share.
RUN = wp.constant(8)
TILE = wp.constant(4)
# Threads that share the columns under one triangle.
LANES = 32


@wp.struct
class Slab:
    """The voxels `first <= i < first + shape[0]` of an axis-aligned grid."""

    origin: wp.vec3d  # centre of the grid's voxel (0,0,0)
    spacing: wp.vec3d
    shape: wp.vec3i  # of the slab
    first: wp.int32


@wp.func
def along(slab: Slab, axis: int, index: int):
    """The coordinate of a voxel centre, rounded to float32: the point that is measured."""
    i = index
    if axis == 0:
        i = index + slab.first
    return float(slab.origin[axis] + wp.float64(i) * slab.spacing[axis])


@wp.func
def voxel(slab: Slab, i: int, j: int, k: int):
    return wp.vec3(along(slab, 0, i), along(slab, 1, j), along(slab, 2, k))


@wp.func
def count_below(slab: Slab, axis: int, x: wp.float64, scale: wp.float64):
    """How many of the slab's voxels along an axis have a (scaled) coordinate below x."""
    count = slab.shape[axis]
    first = 0
    if axis == 0:
        first = slab.first
    guess = (x / scale - slab.origin[axis]) / slab.spacing[axis] - wp.float64(first)
    index = int(wp.clamp(guess, wp.float64(0.0), wp.float64(count)))
    # The guess is off by a voxel at most; what counts is the rounded coordinate itself.
    while index > 0 and scale * wp.float64(along(slab, axis, index - 1)) >= x:
        index = index - 1
    while index < count and scale * wp.float64(along(slab, axis, index)) < x:
        index = index + 1
    return index


@wp.kernel
def _scan_convert(begin: int, tree: Tree, slab: Slab, lanes: int, values: wp.array4d(dtype=wp.float32)):
    """Each triangle adds its crossing to the last voxel before it, in every column (j,k) that it covers."""
    thread = begin + wp.tid()
    slot = thread / lanes
    lane = thread - slot * lanes
    mesh = slot / tree.count
    scale = tree.frame[mesh * _FRAME_SIZE + _SCALE]
    pa = tree.corners[4 * slot]
    pb = tree.corners[4 * slot + 1]
    pc = tree.corners[4 * slot + 2]
    low = wp.min(pa, wp.min(pb, pc))
    high = wp.max(pa, wp.max(pb, pc))
    if count_below(slab, 0, wp.float64(high[0]), scale) == 0:
        return
    # Columns are snapped before they are tested, hence the slack.
    j_begin = count_below(slab, 1, wp.float64(low[1]) - LATTICE_SLACK, scale)
    j_end = count_below(slab, 1, wp.float64(high[1]) + LATTICE_SLACK, scale)
    k_begin = count_below(slab, 2, wp.float64(low[2]) - LATTICE_SLACK, scale)
    k_end = count_below(slab, 2, wp.float64(high[2]) + LATTICE_SLACK, scale)
    width = k_end - k_begin
    a = tree.lattice[3 * slot]
    b = tree.lattice[3 * slot + 1]
    c = tree.lattice[3 * slot + 2]
    cell = lane
    columns = (j_end - j_begin) * width
    while cell < columns:
        j = j_begin + cell / width
        k = k_begin + cell % width
        q = to_lattice(tree, mesh, scale * wp.float64(along(slab, 1, j)), scale * wp.float64(along(slab, 2, k)))
        sign = covers(a, b, c, q)
        if sign != 0:
            below = count_below(slab, 0, crossing_x(tree, slot, q), scale)
            if below > 0:
                wp.atomic_add(values, mesh, below - 1, j, k, float(sign))
        cell = cell + lanes


@wp.kernel
def _sum_columns(begin: int, slab: Slab, values: wp.array4d(dtype=wp.float32)):
    """From crossings to winding numbers: a voxel sees every crossing at or beyond it."""
    i = begin + wp.tid()
    columns = slab.shape[1] * slab.shape[2]
    mesh = i / columns
    j = (i - mesh * columns) / slab.shape[2]
    k = i % slab.shape[2]
    total = float(0.0)
    for back in range(slab.shape[0]):
        x = slab.shape[0] - 1 - back
        total = total + values[mesh, x, j, k]
        values[mesh, x, j, k] = total


@wp.kernel
def _add_boundary(begin: int, tree: Tree, winding: Winding, slab: Slab, values: wp.array4d(dtype=wp.float32)):
    at = begin + wp.tid()
    k = at % slab.shape[2]
    j = (at / slab.shape[2]) % slab.shape[1]
    row = at / (slab.shape[1] * slab.shape[2])
    mesh = row / slab.shape[0]
    i = row % slab.shape[0]
    p = tree.frame[mesh * _FRAME_SIZE + _SCALE] * wp.vec3d(voxel(slab, i, j, k))
    share = float(0.0)
    if winding.kind == _SOUP:
        share = float(soup_winding(tree, winding.moments, mesh, p))
    else:
        share = float(boundary_winding(winding.boundary, tree, mesh, p))
    values[mesh, i, j, k] = values[mesh, i, j, k] + share


@wp.kernel
def _measure(
    begin: int,
    tree: Tree,
    slab: Slab,
    values: wp.array4d(dtype=wp.float32),
    ambiguous: wp.array(dtype=wp.int32),
):
    thread = begin + wp.tid()
    tiles_j = (slab.shape[1] + TILE - 1) / TILE
    tiles_i = (slab.shape[0] + TILE - 1) / TILE
    runs = (slab.shape[2] + RUN - 1) / RUN
    inner = thread % (TILE * TILE)
    rest = thread / (TILE * TILE)
    run = rest % runs
    rest = rest / runs
    j = (rest % tiles_j) * TILE + inner % TILE
    rest = rest / tiles_j
    i = (rest % tiles_i) * TILE + inner / TILE
    mesh = rest / tiles_i
    if i >= slab.shape[0] or j >= slab.shape[1]:
        return
    scale = tree.frame[mesh * _FRAME_SIZE + _SCALE]
    unscale = tree.frame[mesh * _FRAME_SIZE + _UNSCALE]
    guess = mesh * tree.count
    unclear = int(0)
    for step in range(RUN):
        k = run * RUN + step
        if k < slab.shape[2]:
            point = voxel(slab, i, j, k)
            guess = nearest_slot(tree, mesh, float(scale) * point, guess)
            hit = closest_point(
                scale * wp.vec3d(point),
                wp.vec3d(tree.corners[4 * guess]),
                wp.vec3d(tree.corners[4 * guess + 1]),
                wp.vec3d(tree.corners[4 * guess + 2]),
            )
            distance = float(wp.sqrt(hit.distance2) * unscale)
            winding = values[mesh, i, j, k]
            if wp.abs(winding - 0.5) < 0.25:
                unclear = unclear + 1
            values[mesh, i, j, k] = wp.where(winding > 0.5, -distance, distance)
    if unclear > 0:
        wp.atomic_add(ambiguous, mesh, unclear)


def query_slab(
    tree: Tree, winding: Winding, slab: Slab, values: wp.array, ambiguous: wp.array, launch: Any
) -> None:
    """Signed distances of a slab of voxels for a batch of meshes.

    Args:
        tree: The hierarchy of the batch.
        winding: How winding numbers are found.
        slab: Which voxels.
        values: (meshes, n, ny, nz) float32, filled: negative inside.
        ambiguous: (meshes,) int32: the number of voxels whose winding number is within 0.25 of 0.5 is added.
        launch: `sdm.kernels.launch.launch`.
    """
    device = values.device
    meshes, nx, ny, nz = values.shape
    values.zero_()
    if winding.kind != SOUP:
        lanes = LANES if device.is_cuda else 1
        launch(_scan_convert, meshes * tree.count * lanes, [tree, slab, lanes, values], device)
        launch(_sum_columns, meshes * ny * nz, [slab, values], device)
    if winding.kind != CLOSED:
        launch(_add_boundary, meshes * nx * ny * nz, [tree, winding, slab, values], device)
    tile, run = int(TILE), int(RUN)
    threads = meshes * -(-nx // tile) * -(-ny // tile) * -(-nz // run) * tile * tile
    launch(_measure, threads, [tree, slab, values, ambiguous], device)
