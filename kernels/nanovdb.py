"""Dense values in and out of a NanoVDB volume."""

from __future__ import annotations

import warp as wp

from sdm.kernels.launch import launch


@wp.kernel
def _store(begin: int, volume: wp.uint64, first: int, values: wp.array3d(dtype=wp.float32)):
    t = begin + wp.tid()
    ny = values.shape[1]
    nz = values.shape[2]
    k = t % nz
    j = (t // nz) % ny
    i = t // (nz * ny)
    wp.volume_store_f(volume, first + i, j, k, values[i, j, k])


def store(volume: wp.Volume, first: int, values: wp.array) -> None:
    """Put `values` (n,ny,nz) float32 at the voxels (first + i, j, k), which the volume must have allocated."""
    launch(_store, values.size, [volume.id, first, values], values.device)


@wp.kernel
def _lookup(begin: int, volume: wp.uint64, first: int, values: wp.array3d(dtype=wp.float32)):
    t = begin + wp.tid()
    ny = values.shape[1]
    nz = values.shape[2]
    k = t % nz
    j = (t // nz) % ny
    i = t // (nz * ny)
    values[i, j, k] = wp.volume_lookup_f(volume, first + i, j, k)


def lookup(volume: wp.Volume, first: int, values: wp.array) -> None:
    """Fill `values` (n,ny,nz) float32 from the voxels (first + i, j, k)."""
    launch(_lookup, values.size, [volume.id, first, values], values.device)
