"""Chunks of a list of meshes and grids: as many at a time as a bound of memory allows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import torch

from sdm.core.device import total_memory
from sdm.core.given_values import whole
from sdm.errors import SDMError

T = TypeVar("T")

# Bytes of a chunk: of a GPU's memory this share, and of a CPU, whose caches are small and which gains little.
GPU_SHARE, CPU_BYTES = 24, 1 << 28
# What a triangle takes while its structure is built and searched, and what a voxel does.
TRIANGLE_BYTES, VOXEL_BYTES = 1000, 8
# Of meshes, and of triangles and voxels, whose numbers have 32 bits.
MOST_MESHES, MOST_TRIANGLES, MOST_VOXELS = 1 << 12, 1 << 26, 1 << 29


def bytes_for(device: torch.device) -> int:
    """Bytes of a chunk on a device, where nobody says."""
    return total_memory(device) // GPU_SHARE if device.type == "cuda" else CPU_BYTES


def check_bytes(max_bytes: int) -> None:
    """Refuse what is no number of bytes.

    Raises:
        SDMError: It is none.
    """
    if whole(max_bytes, 0) is None:
        raise SDMError(f"max_bytes is {max_bytes!r}; give a whole number of bytes")


def in_chunks(items: Iterable[T], load: Callable[[T], tuple[int, int]], limit: Callable[[T], int]) -> Iterator[list[T]]:
    """The items in order, as many at a time as fit: at least one.

    Args:
        items: Taken as they are needed.
        load: Triangles and voxels that an item adds.
        limit: Bytes of a chunk that begins with this item.
    """
    chunk: list[T] = []
    nbytes = triangles = voxels = most = 0
    for item in items:
        its_triangles, its_voxels = load(item)
        its_bytes = TRIANGLE_BYTES * its_triangles + VOXEL_BYTES * its_voxels
        full = len(chunk) == MOST_MESHES or nbytes + its_bytes > most
        if chunk and (full or triangles + its_triangles > MOST_TRIANGLES or voxels + its_voxels > MOST_VOXELS):
            yield chunk
            chunk, nbytes, triangles, voxels = [], 0, 0, 0
        if not chunk:
            most = limit(item)
        chunk.append(item)
        nbytes, triangles, voxels = nbytes + its_bytes, triangles + its_triangles, voxels + its_voxels
    if chunk:
        yield chunk


def voxels_of(shape: tuple[int, ...]) -> int:
    """Voxels of a grid of this shape, with the room that lets the next map begin at a multiple of 256 bytes."""
    return -(-math.prod(shape) // 64) * 64
