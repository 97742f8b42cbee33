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

from sdm.kernels.edt_lines import nearest_on_line
from sdm.kernels.edt_near import NEIGHBOURS, Marks
from sdm.kernels.edt_rows import nearest_in_row
from sdm.kernels.lanes import GPU_LANES

# Lines are few and long: small blocks spread them over all of a GPU.
BLOCK_DIM = 64
# Threads for a line on a GPU whose voxels ask their neighbours alone.
PIECES = 8


def transform(
    mask: wp.array,
    shape: tuple[int, int, int, int],
    spacing: tuple[float, float, float],
    half: float,
    signed: bool,
    missing: float,
    room: tuple[wp.array, wp.array, wp.array],
    out: wp.array,
    launch: Any,
) -> None:
    """Fill `out` with distances to the nearest voxel of the other class.

    Args:
        mask: uint8, flat; not zero is inside.
        shape: (B,nx,ny,nz).
        spacing: Size of a voxel along each axis.
        half: 0 to measure to a voxel's centre, 0.5 to the nearest point of its box.
        signed: Whether voxels inside get minus their distance to the outside, rather than 0.
        missing: Distance where there is no voxel of the other class.
        room: Scratch, float32 and int32, each as large as the mask, and int32 zeros: B * nz * (nx + ny).
        out: float32, flat.
        launch: See `launch.launch`.
    """
    meshes, nx, ny, nz = shape
    device = mask.device
    # In units of the largest spacing an isotropic grid's squared distances are whole numbers or quarters: exact.
    unit = max(spacing)
    weights = [(s / unit) * (s / unit) for s in spacing]
    between, stack, far = room
    rows, lines = meshes * nx * ny, meshes * nx * nz
    sides = 2 if signed else 1
    lanes = GPU_LANES if device.is_cuda else 1
    # Never more threads than voxels, which are counted in 32 bits.
    in_x, in_y = (min(PIECES, n) if device.is_cuda else 1 for n in (nx, ny))
    along_y = _marks(far[:lines], weights[1], half)
    along_x = _marks(far[lines:], weights[0], half)
    none = _marks(far[:1], math.inf, half)
    row = [mask, nz, lanes, weights[2], half, int(signed), along_y, ny, out]
    launch(nearest_in_row, rows * lanes, row, device)
    line = [lines, in_y, out, ny, nz, weights[1], half, sides, 0.0, missing, along_y, along_x, nx, stack, between]
    launch(nearest_on_line, lines * in_y, line, device, BLOCK_DIM)
    lines = meshes * ny * nz
    line = [
        lines,
        in_x,
        between,
        nx,
        ny * nz,
        weights[0],
        half,
        sides,
        unit,
        missing,
        along_x,
        none,
        1,
        stack,
        out,
    ]
    launch(nearest_on_line, lines * in_x, line, device, BLOCK_DIM)


def _marks(far: wp.array, weight: float, half: float) -> Any:
    marks = Marks()
    marks.far = far
    marks.limit = weight * (int(NEIGHBOURS) - half) ** 2
    return marks
