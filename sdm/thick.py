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
from collections.abc import Callable
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
# Voxels of a slab of the finer grid, which bounds memory; it has as many layers as whole regions at least, and with
# these never more voxels than the third number.
MOST_VOXELS = 1 << 23
LAYERS = 32
LARGEST = 1 << 27
MOST_LAYERS = (1 << 31) // max(FACTORS) - LAYERS

Triple: TypeAlias = tuple[int, int, int]
AS_IT_IS: Triple = (1, 1, 1)


@dataclass(frozen=True)
class Slices:
    """Layers of a grid: `shape` (n,ny,nz) from layer `first` on, `spacing` apart."""

    spacing: tuple[float, ...]
    shape: tuple[int, ...]
    first: int


# Fills values (B,n,ny,nz) and counts of ambiguous voxels (B,), or uses the values and writes to an address (1,).
Query: TypeAlias = Callable[[Slices, Tensor, Tensor, Tensor | None], None]


def finer(slices: Slices, scale: float, triangles: int) -> Triple:
    """How many times as many slices along each axis the grid should have that is measured, or `AS_IT_IS`.

    Args:
        slices: Of slabs of one grid their number along the first axis does not matter, so that all are treated alike.
        scale: What a mesh's coordinates are multiplied by, so that it is at most 2 wide.
        triangles: Of the mesh.
    """
    usual = _cost(slices, AS_IT_IS, scale)
    # Layers are counted with 32 bits.
    if usual == CELL or slices.first + slices.shape[0] > MOST_LAYERS:
        return AS_IT_IS
    if search_is_faster(triangles, slices.shape, gpu=False):
        return AS_IT_IS
    found: list[Triple] = [(x, y, z) for x, y, z in product(FACTORS, repeat=3)]
    room = [times for times in found if LAYERS * math.prod(_across(slices, times)) <= LARGEST]
    times = min(room, key=lambda times: _cost(slices, times, scale), default=AS_IT_IS)
    return times if _cost(slices, times, scale) <= WORTH_IT * usual else AS_IT_IS


def scales_of(tree: Any, meshes: int) -> list[float]:
    """What each mesh of a `Tree` is multiplied by; waits for the device."""
    return tree.frame.numpy().reshape(meshes, FRAME_SIZE)[:, SCALE].tolist()


def _across(slices: Slices, times: Triple) -> tuple[int, ...]:
    """Voxels of the finer grid along the second and the third axis."""
    return tuple(k * (n - 1) + 1 for k, n in zip(times[1:], slices.shape[1:], strict=True))


def _cost(slices: Slices, times: Triple, scale: float) -> float:
    """Of a voxel that is kept, in those of a cell."""
    size = int(BLOCK)
    one = CELL if _fits(size, slices, times, scale) else BRICK if _fits(size // 2, slices, times, scale) else SEARCH
    return math.prod(times) * one


def _fits(size: int, slices: Slices, times: Triple, scale: float) -> bool:
    """Whether boxes of up to so many voxels along their edges are narrow enough to be measured."""
    # The first slab is the whole grid if it has less layers than one.
    count = (slices.shape[0] if slices.first == 0 else size), *slices.shape[1:]
    # A little less, as the kernels round.
    return all(
        0.5005 * (min(size, k * (n - 1) + 1) - 1) * (scale * s / k) <= float(COARSEST)
        for n, s, k in zip(count, slices.spacing, times, strict=True)
    )


def measured_finer(query: Query, slices: Slices, times: Triple) -> tuple[Tensor, Tensor]:
    """A mesh's distances (1,n,ny,nz) in slices of which a grid has `times` as many; how many are ambiguous (1,).

    Args:
        query: Measures slices: writes distances to an address, and uses `values` for winding numbers.
        slices: Those that are wanted.
        times: See `finer`.
    """
    found = torch.empty((1, *slices.shape), dtype=torch.float32)
    ambiguous = torch.zeros(1, dtype=torch.int32)
    # Along the first axis as far as to the next slab, so that slabs together are the whole map.
    layers, across = times[0] * slices.shape[0], _across(slices, times)
    spacing = tuple(s / k for s, k in zip(slices.spacing, times, strict=True))
    room = max(LAYERS, MOST_VOXELS // math.prod(across) // LAYERS * LAYERS)
    for begin in range(0, layers, room):
        shape = min(room, layers - begin), *across
        distances, winding = (torch.empty((1, *shape), dtype=torch.float32) for _ in range(2))
        # Counted below, of the voxels that are kept.
        unused = torch.zeros_like(ambiguous)
        at = Slices(spacing, shape, times[0] * slices.first + begin)
        query(at, winding, unused, torch.tensor([distances.data_ptr()]))
        kept = slice(begin // times[0], (begin + shape[0]) // times[0])
        every = (slice(None), *(slice(None, None, k) for k in times))
        found[:, kept] = distances[every]
        ambiguous += int(((winding[every] - 0.5).abs() < 0.25).sum())
    return found, ambiguous
