"""Maps of thick slices, on a CPU: of a grid with several times as many, of which each so many are kept.

A cell of 8^3 voxels that is wide beside the mesh is rounded too much for its triangles to be told apart in float32
(`sdm.kernels.dense.region_grid.is_coarse`). It is then measured in bricks of 4^3, which takes longer, and if these are
too wide as well, every voxel is searched, which takes ten times as long again. Clinical images are like that along one
axis: twenty slices through an organ that is 200 voxels wide. On a grid whose spacing there is a half, a quarter, an
eighth or a sixteenth the cells are narrow enough, and so much faster that most of their voxels may be thrown away.

Divisions by powers of two are exact, so the voxels that are kept are where they were, to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor

from sdm.kernels.bvh.tree import FRAME_SIZE, REACH, SCALE
from sdm.kernels.dense.cost_model import THINNEST_SLAB, expected_list, search_is_faster
from sdm.kernels.dense.region_grid import BLOCK, COARSEST
from sdm.kernels.plan_options import PlanOptions

# What a voxel takes in a cell and in a brick with short lists, which take twice as long with so many triangles, and
# searched (measured: bench/decisions/0013-thick-slices-on-a-cpu.md); in a grid that is finer a map takes at most so
# much of what it took.
CELL, BRICK, SEARCH = 1.0, 5.0, 40.0
SHORT = 900
WORTH_IT = 0.7
# So few triangles are searched as fast.
FEWEST = 200
# Voxels of the thinnest slab of a finer grid that there may be, which bounds memory.
LARGEST = 1 << 25
# Steps of a mesh's largest coordinate, and the smallest, of a mesh that is a point.
STEPS, SMALLEST = 16, 2.0**-32
MOST_LAYERS = (1 << 31) // max(PlanOptions.slice_factors) - THINNEST_SLAB

Triple: TypeAlias = tuple[int, int, int]
AS_IT_IS: Triple = (1, 1, 1)


@dataclass(frozen=True)
class Slices:
    """Layers of a grid: `shape` (n,ny,nz) from layer `first` on, `spacing` apart."""

    spacing: tuple[float, ...]
    shape: tuple[int, ...]
    first: int


@lru_cache(maxsize=256)
def finer(slices: Slices, scale: float, triangles: int, factors: tuple[int, ...] = PlanOptions.slice_factors) -> Triple:
    """Factors along each axis by which the measured grid has more slices, or `AS_IT_IS`.

    Args:
        slices: Of slabs of one grid their number along the first axis does not matter, so that all are treated alike.
        scale: See `scales_of`.
        triangles: Of the mesh.
        factors: Those to choose from, see `PlanOptions.slice_factors`.
    """
    # Remembered, as a hundred candidates take the host as long as the rest of a small map.
    # Layers are counted with 32 bits.
    if triangles < FEWEST or slices.first + slices.shape[0] > MOST_LAYERS:
        return AS_IT_IS
    if _fits(int(BLOCK), slices, AS_IT_IS, scale) or search_is_faster(triangles, slices.shape, gpu=False):
        return AS_IT_IS
    length = expected_list(triangles, slices.shape, int(BLOCK))
    usual = _cost(slices, AS_IT_IS, scale, length)
    found: list[Triple] = [(x, y, z) for x, y, z in product(factors, repeat=3)]
    room = [times for times in found if has_room(slices, times, 1)]
    times = min(room, key=lambda times: _cost(slices, times, scale, length))
    return times if _cost(slices, times, scale, length) <= WORTH_IT * usual else AS_IT_IS


def scales_of(tree: Any, meshes: int) -> list[float]:
    """Factors that bring each mesh of a `Tree` to a largest coordinate of 1, or a little more; waits for the device.

    So a mesh that moves mostly has the factor that it had: decisions are remembered by it.
    """
    frame = tree.frame.numpy().reshape(meshes, FRAME_SIZE)
    largest = np.maximum(np.floor(STEPS * frame[:, REACH]) / STEPS, SMALLEST)
    return (frame[:, SCALE] / largest).tolist()


def _across(slices: Slices, times: Triple) -> tuple[int, ...]:
    """Voxels of the finer grid along the second and the third axis."""
    return tuple(k * (n - 1) + 1 for k, n in zip(times[1:], slices.shape[1:], strict=True))


def _cost(slices: Slices, times: Triple, scale: float, length: float) -> float:
    """Of a voxel that is kept, in those of a cell with a short list; lists have so many triangles."""
    longer = 1 + length / SHORT
    size = int(BLOCK)
    if _fits(size, slices, times, scale):
        return math.prod(times) * CELL * longer
    return math.prod(times) * (BRICK * longer if _fits(size // 2, slices, times, scale) else SEARCH)


def _fits(size: int, slices: Slices, times: Triple, scale: float) -> bool:
    """True if boxes of up to so many voxels along their edges are narrow enough to be measured."""
    # The first slab is the whole grid if it has less layers than one.
    count = (slices.shape[0] if slices.first == 0 else size), *slices.shape[1:]
    # A little less, as the kernels round.
    return all(
        0.5005 * (min(size, k * (n - 1) + 1) - 1) * (scale * s / k) <= float(COARSEST)
        for n, s, k in zip(count, slices.spacing, times, strict=True)
    )


def has_room(slices: Slices, times: Triple, meshes: int) -> bool:
    """True if the thinnest slab of so many meshes' finer grids is not too large."""
    return times == AS_IT_IS or meshes * THINNEST_SLAB * math.prod(_across(slices, times)) <= LARGEST


def measured_finer(
    values: Tensor,
    slices: Slices,
    times: Triple,
    measure: Callable[[Slices, Tensor], object],
    slab_voxels: int,
) -> Tensor:
    """Distances in slices of which a grid has `times` as many, with their signs; how many are ambiguous (B,).

    Args:
        values: (B,n,ny,nz) float32, winding numbers, which become signed distances.
        slices: Those that are wanted.
        times: See `finer`.
        measure: Fills values in the finer grid's slices with distances without a sign: for an open mesh signs are most
            of the work.
        slab_voxels: See `PlanOptions`.
    """
    ambiguous = ((values - 0.5).abs() < 0.25).flatten(1).sum(1, dtype=torch.int32)
    # Along the first axis as far as to the next slab, so that slabs together are the whole map.
    meshes, layers, across = values.shape[0], times[0] * slices.shape[0], _across(slices, times)
    spacing = tuple(s / k for s, k in zip(slices.spacing, times, strict=True))
    room = max(THINNEST_SLAB, slab_voxels // (meshes * math.prod(across)) // THINNEST_SLAB * THINNEST_SLAB)
    for begin in range(0, layers, room):
        shape = min(room, layers - begin), *across
        fine = torch.empty((meshes, *shape), dtype=torch.float32)
        measure(Slices(spacing, shape, times[0] * slices.first + begin), fine)
        distances = fine[(slice(None), *(slice(None, None, k) for k in times))]
        kept = values[:, begin // times[0] : (begin + shape[0]) // times[0]]
        kept.copy_(torch.where(kept > 0.5, -distances, distances))
    return ambiguous
