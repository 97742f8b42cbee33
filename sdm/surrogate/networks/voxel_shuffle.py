"""Voxel shuffle, pixel shuffle in 3D: voxels as channels of the cube that they lie in, and back."""

from __future__ import annotations

from torch import Tensor


def split(maps: Tensor, edge: int) -> Tensor:
    """(B,1,nx,ny,nz) to (B, edge^3, nx/edge, ny/edge, nz/edge): a block's voxels become its channels."""
    batch, _, nx, ny, nz = maps.shape
    parts = maps.reshape(batch, nx // edge, edge, ny // edge, edge, nz // edge, edge)
    return parts.permute(0, 2, 4, 6, 1, 3, 5).reshape(batch, edge**3, nx // edge, ny // edge, nz // edge)


def merge(blocks: Tensor, edge: int) -> Tensor:
    """The inverse of `split`: (B, edge^3, x, y, z) to (B, 1, x edge, y edge, z edge)."""
    batch, _, x, y, z = blocks.shape
    parts = blocks.reshape(batch, edge, edge, edge, x, y, z).permute(0, 4, 1, 5, 2, 6, 3)
    return parts.reshape(batch, 1, x * edge, y * edge, z * edge)
