"""Exact Euclidean distance transform of binary volumes: one pass for each axis.

Squared distances add over the axes, so the nearest voxel is found axis by axis: first in each row, then along the other
two, among a voxel's neighbours where that is enough and by lower envelopes where not. Time is proportional to the
number of voxels, whatever the mask.

Both sides of a signed transform share the memory: seen from outside a voxel inside is at distance zero, so one number
with a sign holds what both need.
"""

from __future__ import annotations

import math
from typing import Any

import warp as wp

from sdm.kernels.edt.envelopes import find_envelopes
from sdm.kernels.edt.pass1_rows import nearest_in_row
from sdm.kernels.edt.pass2_lines import nearest_on_line
from sdm.kernels.edt.short_range import NEIGHBOURS, Marks, nearest_among_neighbours
from sdm.kernels.launch import launch
from sdm.kernels.primitives.lanes import GPU_LANES

# Lines are few and long: small blocks spread them over all of a GPU.
BLOCK_DIM = 64
# Pieces of a line, with a thread each.
PIECES = {"cuda": 8, "cpu": 1}


def room_for(shape: tuple[int, int, int, int], signed: bool) -> dict[str, int]:
    """Length of each kind of workspace that `transform` needs for volumes (B,nx,ny,nz)."""
    meshes, nx, ny, nz = shape
    voxels = meshes * nx * ny * nz
    marks = (2 if signed else 1) * meshes * nz * (nx + ny)
    return {
        "between": voxels,
        "stack": voxels,
        "counts": max(PIECES.values()) * meshes * nz * max(nx, ny),
        "marks": marks,
    }


def transform(
    mask: wp.array,
    shape: tuple[int, int, int, int],
    spacing: tuple[float, float, float],
    half: float,
    signed: bool,
    missing: float,
    room: dict[str, wp.array],
    out: wp.array,
    span: tuple[int, int] | None = None,
) -> None:
    """Fill `out` with distances to the nearest voxel of the other class.

    Args:
        mask: uint8, flat; not zero is inside.
        shape: (B,nx,ny,nz).
        spacing: Size of a voxel along each axis.
        half: 0 to measure to a voxel's centre, 0.5 to the nearest point of its box.
        signed: Whether voxels inside get minus their distance to the outside, rather than 0.
        missing: Distance where there is no voxel of the other class.
        room: Workspace, as large as `room_for` says: `between` float32, all else int32, `marks` zeros.
        out: float32, flat.
        span: Of a single volume, the first slice along x with a voxel inside and the one after the last. Slices beyond
            have none to measure to within themselves, and are left out of the first two passes: `between` is infinite
            there to begin with. The values are the same.
    """
    meshes, nx, ny, nz = shape
    device = mask.device
    # In units of the largest spacing an isotropic grid's squared distances are whole numbers or quarters: exact.
    unit = max(spacing)
    weights = [(s / unit) * (s / unit) for s in spacing]
    lanes = GPU_LANES if device.is_cuda else 1
    first, last = span or (0, nx)
    # Of the first two passes.
    thick = last - first
    across_y, across_x = meshes * thick * nz, meshes * ny * nz
    sides = 2 if signed else 1
    ends_y = sides * meshes * nx * nz
    along_y = _marks(room["marks"][: sides * across_y], sides, weights[1], half)
    along_x = _marks(room["marks"][ends_y:], sides, weights[0], half)
    none = _marks(room["marks"], 1, math.inf, half)
    within, halfway, inside = out, room["between"], mask
    if thick < nx:
        # Every line along x has a voxel in a slice that is left out, from where the other class is far.
        along_x.outside.fill_(1)
        within, halfway, inside = (array[first * ny * nz : last * ny * nz] for array in (within, halfway, inside))
    row = [inside, nz, lanes, weights[2], half, int(signed), along_y, ny, within]
    launch(nearest_in_row, meshes * thick * ny * lanes, row, device)
    passes = (
        (across_y, within, ny, nz, weights[1], 0.0, along_y, along_x, thick, halfway),
        (across_x, room["between"], nx, ny * nz, weights[0], unit, along_x, none, 1, out),
    )
    for lines, heights, length, stride, weight, scale, marks, following, across, to in passes:
        # Never more threads than voxels, which are counted in 32 bits.
        pieces = min(PIECES["cuda" if device.is_cuda else "cpu"], length)
        line = [lines, pieces, heights, length, stride, weight, half]
        ends = [scale, missing, following, across, to]
        launch(nearest_among_neighbours, lines * pieces, [*line, marks, *ends], device, BLOCK_DIM)
        piles = [room["stack"], room["counts"]]
        for side, far in ((1.0, marks.outside), (-1.0, marks.inside))[:sides]:
            inputs = [*line, side, far, *piles]
            if device.is_cuda or pieces > 1:
                launch(find_envelopes, lines * pieces, inputs, device, BLOCK_DIM)
            launch(nearest_on_line, lines * pieces, [*inputs, *ends], device, BLOCK_DIM)


def _marks(far: wp.array, sides: int, weight: float, half: float) -> Any:
    """Marks in memory for so many sides."""
    lines = far.shape[0] // sides
    marks = Marks()
    marks.outside, marks.inside = far[:lines], far[-lines:]
    marks.limit = weight * (int(NEIGHBOURS) - half) ** 2
    return marks
