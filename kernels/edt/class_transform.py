"""Exact distance transforms of many classes of one label volume, in one pass for each axis.

What differs from the transform of masks (`edt.transform`): nothing is measured where a class is not, rows and slices
that lack it being skipped on the device; and the distances inside need one volume for all classes, as from inside its
own class a voxel's nearest other one is the nearest voxel with another label.
"""

from __future__ import annotations

import math
from typing import Any

import warp as wp

from sdm.kernels.edt.class_bundles import nearest_of_class_in_bundle, nearest_other_label_in_bundle
from sdm.kernels.edt.class_lines import nearest_of_class_on_line, nearest_other_label_on_line
from sdm.kernels.edt.class_rows import nearest_of_classes, nearest_other_label
from sdm.kernels.edt.transform import BLOCK_DIM
from sdm.kernels.launch import launch
from sdm.kernels.primitives.lanes import GPU_LANES

# Lines side by side from which on they are measured by bundles, of which a CPU's, of one line, gain nothing.
FEWEST_IN_BUNDLE = {"cuda": 16, "cpu": math.inf}
BUNDLE_BLOCK_DIM = 128
MOST_THREADS = (1 << 31) - 1


def own_distances(
    labels: wp.array,
    first_value: int,
    kinds: int,
    shape: tuple[int, int, int],
    spacing: tuple[float, float, float],
    half: float,
    missing: float,
    row_ends: wp.array,
    slice_ends: wp.array,
    between: wp.array,
    own: wp.array,
) -> None:
    """Fill `own` with distances of the voxels of all classes to the nearest voxel with another label.

    Args:
        labels: uint8, flat.
        first_value: That of the first class; the others' follow.
        kinds: Number of classes. Voxels of none are left alone.
        shape: (nx,ny,nz).
        spacing: Size of a voxel along each axis.
        half: 0 to measure to a voxel's centre, 0.5 to the nearest point of its box.
        missing: Distance where all labels are equal.
        row_ends: What `find_rows` has filled.
        slice_ends: See there.
        between: Workspace, float32, a number a voxel.
        own: float32, flat.
    """
    nx, ny, nz = shape
    device, unit, weights = labels.device, max(spacing), _weights(spacing)
    lanes = GPU_LANES if device.is_cuda else 1
    launch(nearest_other_label, nx * ny * lanes, [labels, nz, lanes, weights[2], half, own], device)
    passes = (
        (nx, ny, nz, row_ends, own, weights[1], 0.0, between),
        (1, nx, ny * nz, slice_ends, between, weights[0], unit, own),
    )
    for outers, length, stride, ends, heights, weight, scale, to in passes:
        if stride >= FEWEST_IN_BUNDLE[_kind(device)]:
            bundles = -(-stride // lanes)
            places = [outers, length, stride, bundles, lanes, weight, half, scale, missing, to]
            threads = outers * bundles * lanes
            together = max(1, MOST_THREADS // threads)
            for kind in range(0, kinds, together):
                inputs = [labels, first_value + kind, heights, ends[2 * kind * outers :], *places]
                count = min(together, kinds - kind) * threads
                launch(nearest_other_label_in_bundle, count, inputs, device, BUNDLE_BLOCK_DIM)
        else:
            inputs = [labels, first_value, kinds, heights, row_ends, length, stride, weight, half, scale, missing, to]
            launch(nearest_other_label_on_line, outers * stride, inputs, device, BLOCK_DIM)


def find_rows(
    labels: wp.array,
    first_value: int,
    shape: tuple[int, int, int, int],
    spacing: tuple[float, float, float],
    half: float,
    row_has: wp.array,
    row_ends: wp.array,
    slice_ends: wp.array,
    out: wp.array,
) -> None:
    """The first pass: squared distances in the rows that have a class, and where these are.

    Args:
        labels: uint8, flat.
        first_value: That of the first class; the others' follow.
        shape: (C,nx,ny,nz), classes first.
        spacing: Size of a voxel along each axis.
        half: See `own_distances`.
        row_has: int32, C * nx * ny zeros, filled.
        row_ends: int32, 2 * C * nx zeros, filled.
        slice_ends: int32, 2 * C zeros, filled.
        out: float32, flat.
    """
    kinds, nx, ny, nz = shape
    device = labels.device
    lanes = GPU_LANES if device.is_cuda else 1
    ends = [row_has, row_ends, slice_ends]
    rows = [labels, first_value, kinds, nx * ny, ny, nz, lanes, _weights(spacing)[2], half, *ends, out]
    launch(nearest_of_classes, nx * ny * lanes, rows, device)


def transform_classes(
    shape: tuple[int, int, int, int],
    spacing: tuple[float, float, float],
    half: float,
    signed: bool,
    missing: float,
    own: wp.array,
    row_has: wp.array,
    row_ends: wp.array,
    slice_ends: wp.array,
    between: wp.array,
    out: wp.array,
) -> None:
    """Fill `out`, in which `find_rows` has left the first pass, with distances to the nearest voxel of each class.

    Args:
        shape: (C,nx,ny,nz), classes first.
        spacing: Size of a voxel along each axis.
        half: See `own_distances`.
        signed: Whether voxels of a class get minus their distance in `own`, rather than 0.
        missing: Distance where there is no voxel of the class.
        own: What `own_distances` found; not read if not `signed`.
        row_has: See `find_rows`.
        row_ends: See there.
        slice_ends: See there.
        between: Workspace, float32, C * nx * ny * nz.
        out: float32, flat.
    """
    kinds, nx, ny, nz = shape
    device, unit, weights = out.device, max(spacing), _weights(spacing)
    lanes = GPU_LANES if device.is_cuda else 1
    passes = (
        (kinds * nx, out, row_has, 1, row_ends, ny, nz, weights[1], 0.0, 0, between),
        (kinds, between, row_ends, 2, slice_ends, nx, ny * nz, weights[0], unit, int(signed), out),
    )
    for outers, heights, has, step, ends, length, stride, weight, scale, sides, to in passes:
        line, places = [heights, has, step, ends, length, stride], [weight, half, scale, missing, sides, own, to]
        if stride >= FEWEST_IN_BUNDLE[_kind(device)]:
            bundles = -(-stride // lanes)
            inputs = [*line, bundles, lanes, *places]
            launch(nearest_of_class_in_bundle, outers * bundles * lanes, inputs, device, BUNDLE_BLOCK_DIM)
        else:
            launch(nearest_of_class_on_line, outers * stride, [*line, *places], device, BLOCK_DIM)


def _kind(device: Any) -> str:
    return "cuda" if device.is_cuda else "cpu"


def _weights(spacing: tuple[float, float, float]) -> list[float]:
    # In units of the largest spacing an isotropic grid's squared distances are whole numbers or quarters: exact.
    return [(s / max(spacing)) * (s / max(spacing)) for s in spacing]
