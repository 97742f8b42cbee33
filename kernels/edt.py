"""Exact Euclidean distance transform of binary volumes: one pass for each axis.

Squared distances add over the axes, so the nearest voxel is found axis by axis: first in each row, then by lower
envelopes along the other two. Time is proportional to the number of voxels, whatever the mask.

Both sides of a signed transform share the memory: seen from outside a voxel inside is at distance zero, so one number
with a sign holds what both need.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sdm.kernels.edt_lines import lower_envelope
from sdm.kernels.edt_rows import nearest_in_row
from sdm.kernels.lanes import GPU_LANES

# Lines are few and long: small blocks spread them over all of a GPU.
BLOCK_DIM = 64


def transform(
    mask: wp.array,
    shape: tuple[int, int, int, int],
    spacing: tuple[float, float, float],
    half: float,
    signed: bool,
    missing: float,
    room: tuple[wp.array, wp.array],
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
        room: Scratch, float32 and int32, each as large as the mask.
        out: float32, flat.
        launch: See `launch.launch`.
    """
    meshes, nx, ny, nz = shape
    device = mask.device
    # In units of the largest spacing an isotropic grid's squared distances are whole numbers or quarters: exact.
    unit = max(spacing)
    weights = [(s / unit) * (s / unit) for s in spacing]
    between, stack = room
    rows = meshes * nx * ny
    sides = 2 if signed else 1
    lanes = GPU_LANES if device.is_cuda else 1
    launch(nearest_in_row, rows * lanes, [mask, nz, lanes, weights[2], half, int(signed), out], device)
    along_y = [out, ny, nz, weights[1], half, sides, 0.0, missing, stack, between]
    launch(lower_envelope, meshes * nx * nz, along_y, device, BLOCK_DIM)
    along_x = [between, nx, ny * nz, weights[0], half, sides, unit, missing, stack, out]
    launch(lower_envelope, meshes * ny * nz, along_x, device, BLOCK_DIM)
