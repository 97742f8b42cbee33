"""Crossings of four neighbouring columns in one word, a byte for each: a quarter of the memory is zeroed and read.

A word is the sum of its four signed counts times powers of 256. As long as none leaves -128 to 127 the sum with 128 of
each added has them as its bytes. Counts change by one at a time, so who adds a crossing to one that is beyond 100
notes its column before that can happen; such columns, where a hundred triangles cross within one voxel, are counted
anew by rays.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import warp as wp

from sdm.kernels.bvh.tree import FRAME_SIZE, SCALE, Tree, tree_of
from sdm.kernels.geometry.voxel_grid import Slab, slab_of, unravel, voxel
from sdm.kernels.launch import launch, threads
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import GPU_LANES, gpu_workers
from sdm.kernels.winding.ray_crossings import count_crossings

wp.set_module_options({"enable_backward": False})

# Voxels of a batch from which on crossings are packed on each kind of device: a map of fewer waits for launches. A CPU
# sums columns in its caches; tests pack there, too.
FEWEST = {"cuda": 1 << 22, "cpu": 1 << 62}
# Words of four columns that are loaded at a time; thread blocks that have to fit on a multiprocessor, so that few
# registers are taken from what runs beside: this is bound by memory.
AHEAD, SUM_BLOCKS = 16, 10
# Thread blocks of a multiprocessor that look for columns to be counted anew.
RECOUNT_BLOCKS = 2


class Crossings(NamedTuple):
    """Memory for the crossings of columns, zero before any is added."""

    counts: wp.array  # int32: one for each voxel, or one for each four
    full: wp.array  # int32, if packed: 1 if any column is to be counted anew, then for each four columns; else anything
    packed: bool


def can_be_packed(slab: Slab, total: int, kind: str, alone: bool) -> bool:
    """True if crossings of `total` voxels are packed: of meshes that share a grid whose rows are whole words.

    `alone`: of the meshes of a slab that have grids of their own the first alone has voxels, as many as `slab.shape`.
    """
    return slab.turned == 0 and (alone or slab.meshes == 0) and slab.shape[2] % 4 == 0 and total >= FEWEST[kind]


def new_packed(slab: Slab, total: int, empty: Callable[[int, Any], wp.array]) -> Crossings:
    """Memory for packed crossings of `total` voxels, zeroed; `empty(length, dtype)` allocates."""
    words, fours = total // 4, total // slab.shape[0] // 4
    memory: Any = empty(words + 1 + fours, wp.int32)
    memory.zero_()
    return Crossings(memory[:words], memory[words:], True)


@wp.func_native(
    snippet="""
    const int shift = (index & 3) * 8;
    unsigned* const word = reinterpret_cast<unsigned*>(counts.data) + (index >> 2);
#if defined(__CUDA_ARCH__)
    const unsigned before = atomicAdd(word, (unsigned)sign << shift);
#else
    const unsigned before = __atomic_fetch_add(word, (unsigned)sign << shift, __ATOMIC_RELAXED);
#endif
    const int count = (int)((before + 0x80808080u) >> shift & 255u) - 128;
    if (count > 100 || count < -100) {
        full.data[0] = 1;
        full.data[1 + four] = 1;
    }
"""
)
def _add_packed(counts: wp.array(dtype=wp.int32), full: wp.array(dtype=wp.int32), index: int, four: int, sign: int): ...


@wp.func
def add_crossing(
    counts: wp.array(dtype=wp.int32),
    full: wp.array(dtype=wp.int32),
    packed: int,
    slab: Slab,
    mesh: int,
    index: int,
    j: int,
    k: int,
    sign: int,
):
    """Add a crossing of the column (j,k) to voxel `index`, see `Crossings`."""
    if packed == 0:
        fetch_add(counts, index, sign)
    else:
        _add_packed(counts, full, index, ((mesh * slab.shape[1] + j) * slab.shape[2] + k) / 4, sign)


@wp.func_native(
    snippet=f"""
    const int* word = counts.data + at + (long long)(layers - 1) * fours;
    float* to = values.data + 4 * ((long long)at + (long long)(layers - 1) * fours);
    int total[4] = {{0, 0, 0, 0}};
    #pragma unroll 1
    for (int left = layers; left > 0;) {{
        // All loads before any store, which each would wait for. The first ones may be fewer.
        const int some = left % {AHEAD} ? left % {AHEAD} : {AHEAD};
        unsigned ahead[{AHEAD}];
        #pragma unroll
        for (int i = 0; i < {AHEAD}; ++i, word -= fours)
            ahead[i] = i < some ? *word : 0;
        word += (long long)({AHEAD} - some) * fours;
        #pragma unroll
        for (int i = 0; i < {AHEAD}; ++i, to -= 4 * fours) {{
            const unsigned biased = ahead[i] + 0x80808080u;
            #pragma unroll
            for (int column = 0; column < 4; ++column) total[column] += (int)(biased >> 8 * column & 255u) - 128;
            if (i < some) {{
#if defined(__CUDA_ARCH__)
                *reinterpret_cast<float4*>(to) = make_float4(total[0], total[1], total[2], total[3]);
#else
                for (int column = 0; column < 4; ++column) to[column] = (float)total[column];
#endif
            }}
        }}
        to += 4 * (long long)({AHEAD} - some) * fours;
        left -= some;
    }}
"""
)
def sum_four(
    counts: wp.array(dtype=wp.int32), values: wp.array(dtype=wp.float32), at: int, layers: int, fours: int
): ...


@wp.kernel(launch_bounds=(128, SUM_BLOCKS))
def _sum_packed(begin: int, slab: Slab, counts: wp.array(dtype=wp.int32), values: wp.array(dtype=wp.float32)):
    """From crossings to winding numbers, four columns a thread; see `column_sums`."""
    four = begin + wp.tid()
    fours = slab.shape[1] * slab.shape[2] / 4
    mesh = four / fours
    sum_four(counts, values, mesh * slab.shape[0] * fours + (four - mesh * fours), slab.shape[0], fours)


@wp.kernel
def _count_full(
    begin: int,
    count: int,
    tree: Tree,
    caps: Tree,
    with_caps: int,
    slab: Slab,
    full: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
):
    """Winding numbers of columns whose packed counts say nothing, by a ray for each voxel."""
    if full[0] == 0:
        return
    number = begin + wp.tid()
    fours = slab.shape[1] * slab.shape[2] / 4
    while number < values.shape[0]:
        mesh, at = unravel(number, slab.shape)
        if full[1 + mesh * fours + (at[1] * slab.shape[2] + at[2]) / 4] != 0:
            p = tree.frame[mesh * FRAME_SIZE + SCALE] * wp.vec3d(voxel(slab_of(slab, mesh), at[0], at[1], at[2]))
            found = count_crossings(tree_of(tree, mesh), mesh, p)
            if with_caps != 0:
                found = found + count_crossings(tree_of(caps, mesh), mesh, p)
            values[number] = float(found)
        number = number + count


def sum_packed(slab: Slab, crossings: Crossings, values: wp.array) -> None:
    """Write the winding numbers of all voxels to `values` (voxels), from packed crossings."""
    launch(_sum_packed, values.shape[0] // slab.shape[0] // 4, [slab, crossings.counts, values], values.device)


def count_full(tree: Tree, caps: Tree, with_caps: bool, slab: Slab, crossings: Crossings, values: wp.array) -> None:
    """Count those of columns that are full anew, by rays through `tree` and, `with_caps`, through that of caps."""
    device = values.device
    count = gpu_workers(device, RECOUNT_BLOCKS) * GPU_LANES if device.is_cuda else threads()
    inputs = [count, tree, caps, int(with_caps), slab, crossings.full, values]
    launch(_count_full, count, inputs, device, smallest=1)
