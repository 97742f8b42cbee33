"""Nearest voxels of the foreground: the distance transform's passes again, which keep where each value is from.

One thread a line on either device, by the same envelopes. The nearest voxel's x comes from the last pass, its y from
the one before at that x, and its z from the first one at that x and y.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.edt.envelopes import find_envelope, site_of, start_of
from sdm.kernels.edt.pass1_rows import step_cost
from sdm.kernels.edt.short_range import cost, first_voxel
from sdm.kernels.launch import launch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def sites_in_row(
    begin: int,
    mask: wp.array(dtype=wp.uint8),
    length: int,
    weight: float,
    half: float,
    heights: wp.array(dtype=wp.float32),
    sites: wp.array(dtype=wp.int32),
):
    """The nearest foreground voxel of each row, of two as near the first, and its squared distance."""
    base = (begin + wp.tid()) * length
    site = int(-1)
    for k in range(length):
        if mask[base + k] != wp.uint8(0):
            site = k
        sites[base + k] = site
    after = int(-1)
    for back in range(length):
        k = length - 1 - back
        if mask[base + k] != wp.uint8(0):
            after = k
        nearest = int(sites[base + k])
        if nearest < 0 or (after >= 0 and after - k < k - nearest):
            nearest = after
        sites[base + k] = nearest
        height = float(wp.inf)
        if nearest == k:
            height = 0.0
        elif nearest >= 0:
            height = step_cost(wp.abs(nearest - k), weight, half)
        heights[base + k] = height


@wp.kernel
def sites_on_line(
    begin: int,
    heights: wp.array(dtype=wp.float32),
    length: int,
    stride: int,
    weight: float,
    half: float,
    stack: wp.array(dtype=wp.int32),
    out: wp.array(dtype=wp.float32),
    sites: wp.array(dtype=wp.int32),
):
    """For each voxel of the lines the one through which the way to the foreground is shortest; -1 where none is."""
    base = first_voxel(begin + wp.tid(), length, stride)
    count = find_envelope(heights, base, stride, length, 0, length, weight, half, 1.0, stack)
    entry = int(0)
    for x in range(length):
        at = base + x * stride
        best = heights[at]
        site = int(-1)
        if best < wp.inf:
            site = x
        if count > 0:
            searching = entry + 1 < count
            while searching:
                searching = start_of(stack[base + (entry + 1) * stride]) <= x
                if searching:
                    entry = entry + 1
                    searching = entry + 1 < count
            other = site_of(stack[base + entry * stride])
            value = cost(x, other, heights[base + other * stride], weight, half)
            if value < best:
                best = value
                site = other
        out[at] = best
        sites[at] = site


@wp.kernel
def join_sites(
    begin: int,
    nx: int,
    ny: int,
    nz: int,
    along_x: wp.array(dtype=wp.int32),
    along_y: wp.array(dtype=wp.int32),
    along_z: wp.array(dtype=wp.int32),
    index: wp.array(dtype=wp.int32),
):
    """The nearest voxels' indices (voxels,3); -1 where there is no foreground."""
    voxel = begin + wp.tid()
    x = along_x[voxel]
    y = int(-1)
    z = int(-1)
    if x >= 0:
        layer = ny * nz
        volume = voxel / (nx * layer)
        within = voxel % layer
        base = (volume * nx + x) * layer
        y = along_y[base + within]
        z = along_z[base + y * nz + within % nz]
    index[3 * voxel] = x
    index[3 * voxel + 1] = y
    index[3 * voxel + 2] = z


def nearest_sites(
    mask: wp.array,
    shape: tuple[int, int, int, int],
    spacing: tuple[float, float, float],
    half: float,
    room: dict[str, wp.array],
    index: wp.array,
) -> None:
    """Fill `index` with the nearest foreground voxels.

    Args:
        mask: uint8, flat; not zero is foreground.
        shape: (B,nx,ny,nz).
        spacing: Size of a voxel along each axis.
        half: 0 to measure to a voxel's centre, 0.5 to the nearest point of its box.
        room: Workspace of a number a voxel each: `heights` and `between` float32; `stack`, `x`, `y`, `z` int32.
        index: int32, flat, three for each voxel.
    """
    meshes, nx, ny, nz = shape
    device = mask.device
    unit = max(spacing)
    weights = [(s / unit) * (s / unit) for s in spacing]
    heights, between, stack = room["heights"], room["between"], room["stack"]
    launch(sites_in_row, meshes * nx * ny, [mask, nz, weights[2], half, heights, room["z"]], device)
    for lines, source, length, stride, weight, target, sites in (
        (meshes * nx * nz, heights, ny, nz, weights[1], between, room["y"]),
        (meshes * ny * nz, between, nx, ny * nz, weights[0], heights, room["x"]),
    ):
        launch(sites_on_line, lines, [source, length, stride, weight, half, stack, target, sites], device)
    launch(join_sites, meshes * nx * ny * nz, [nx, ny, nz, room["x"], room["y"], room["z"], index], device)
