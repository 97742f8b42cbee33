"""Maps of thick slices, on a CPU: of a grid with several times as many, of which each so many are kept.

A cell of 8^3 voxels that is wide beside the mesh is rounded too much for its triangles to be told apart in float32
(`sdm.kernels.lists.is_coarse`). It is then measured in bricks of 4^3, which takes longer, and if these are too wide as
well, every voxel is searched, which takes ten times as long again. Clinical images are like that along one axis: twenty
slices through an organ that is 200 voxels wide. On a grid whose spacing there is a half, a quarter, an eighth or a
sixteenth the cells are narrow enough, and so much faster that most of their voxels may be thrown away.

Divisions by powers of two are exact, so the voxels that are kept are where they were, to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeAlias

import torch
from torch import Tensor

from sdm.kernels.effort import search_is_faster
from sdm.kernels.lists import BLOCK, COARSEST
from sdm.kernels.tree import FRAME_SIZE, SCALE

# What a voxel takes in a cell, in a brick, and searched (measured, see bench/NOTES.md); in a grid that is finer a map
# takes at most so much of what it took.
CELL, BRICK, SEARCH = 1.0, 5.0, 36.0
WORTH_IT = 0.7
FACTORS = (1, 2, 4, 8, 16)
# Voxels of a slab of the finer grid, which bounds memory; it has as many layers as whole regions at least.
MOST_VOXELS = 1 << 23
LAYERS = 32
MOST_LAYERS = (1 << 31) // max(FACTORS) - LAYERS

Triple = tuple[int, int, int]


@dataclass(frozen=True)
class Slices:
    """Layers of a grid: `shape` (n,ny,nz) from layer `first` on, `spacing` apart."""

    spacing: tuple[float, ...]
    shape: tuple[int, ...]
    first: int


# Fills values (B,n,ny,nz) and counts of ambiguous voxels (B,), or uses the values and writes to an address (1,).
Query: TypeAlias = Callable[[Slices, Tensor, Tensor, Tensor | None], None]


def finer(slices: Slices, scale: float, triangles: int) -> Triple:
    """How many times as many slices along each axis the grid should have that is measured: (1,1,1) if none.

    Args:
        slices: Their number along the first axis does not matter, so that slabs are treated as the whole map is.
        scale: What a mesh's coordinates are multiplied by, so that it is at most 2 wide.
        triangles: Of the mesh.
    """
    # Layers are counted with 32 bits.
    if search_is_faster(triangles, slices.shape, gpu=False) or slices.first + slices.shape[0] > MOST_LAYERS:
        return 1, 1, 1
    usual = _cost(slices.spacing, (1, 1, 1), scale)
    # A single voxel across is not between any.
    along = (FACTORS if n > 1 else FACTORS[:1] for n in (2, *slices.shape[1:]))
    found: list[Triple] = [(x, y, z) for x, y, z in product(*along)]
    times = min(found, key=lambda times: _cost(slices.spacing, times, scale))
    return times if _cost(slices.spacing, times, scale) <= WORTH_IT * usual else (1, 1, 1)


def largest_scale(tree: Any, meshes: int) -> float:
    """What the smallest mesh of a `Tree` is multiplied by; waits for the device."""
    return float(tree.frame.numpy().reshape(meshes, FRAME_SIZE)[:, SCALE].max())


def _cost(spacing: Sequence[float], times: Sequence[int], scale: float) -> float:
    """Of a voxel that is kept, in those of a cell."""
    widest = scale * max(s / n for s, n in zip(spacing, times, strict=True))
    one = CELL if _fits(int(BLOCK), widest) else BRICK if _fits(int(BLOCK) // 2, widest) else SEARCH
    return math.prod(times) * one


def _fits(voxels: int, widest: float) -> bool:
    """Whether a box of so many voxels along its edge is narrow enough to be measured."""
    # A little less, as the kernels round.
    return 0.5005 * (voxels - 1) * widest <= float(COARSEST)


def measured_finer(query: Query, slices: Slices, times: Triple, meshes: int) -> tuple[Tensor, Tensor]:
    """Distances (B,n,ny,nz) in slices of which a grid has `times` as many, and how many are ambiguous (B,).

    Args:
        query: Measures slices: writes distances to an address, and uses `values` for winding numbers.
        slices: Those that are wanted.
        times: See `finer`.
        meshes: B.
    """
    found = torch.empty((meshes, *slices.shape), dtype=torch.float32)
    ambiguous = torch.zeros(meshes, dtype=torch.int32)
    # Along the first axis as far as to the next slab, so that slabs together are the whole map.
    layers = times[0] * slices.shape[0]
    across = [n * (length - 1) + 1 for n, length in zip(times[1:], slices.shape[1:], strict=True)]
    spacing = tuple(s / n for s, n in zip(slices.spacing, times, strict=True))
    room = max(LAYERS, MOST_VOXELS // (meshes * math.prod(across)) // LAYERS * LAYERS)
    for begin in range(0, layers, room):
        shape = min(room, layers - begin), *across
        distances, winding = (torch.empty((meshes, *shape), dtype=torch.float32) for _ in range(2))
        # Counted below, of the voxels that are kept.
        unused = torch.zeros_like(ambiguous)
        at = Slices(spacing, shape, times[0] * slices.first + begin)
        query(at, winding, unused, torch.tensor([distances.data_ptr()]))
        kept = slice(begin // times[0], (begin + shape[0]) // times[0])
        every = (slice(None), *(slice(None, None, n) for n in times))
        found[:, kept] = distances[every]
        ambiguous += ((winding[every] - 0.5).abs() < 0.25).flatten(1).sum(1, dtype=torch.int32)
    return found, ambiguous
