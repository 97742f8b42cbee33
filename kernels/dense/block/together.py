"""Measurement of a block by all groups of lanes of a thread block together: where blocks are few, more of a GPU works.

Each group takes up to 32 of the next features, which are sorted by their kind before, as lanes with different kinds
wait for each other. It works them out in memory of its own, and measures them there as in `measuring`. In the end the
least of the groups' values are the block's: the bits are those of one group. A CPU has one group of one lane.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.bvh.tree import Tree, load_corners
from sdm.kernels.culling.voronoi_features import Features
from sdm.kernels.dense.block.feature_setup import (
    CORNER_KIND,
    EDGE_KIND,
    FACE_KIND,
    FeatureBatch,
    add_corner,
    add_edge,
    add_face,
    tests_of,
)
from sdm.kernels.dense.block.measuring import measure_features
from sdm.kernels.dense.block.min_values import clear_values
from sdm.kernels.dense.block.octant_tests import octants_of
from sdm.kernels.dense.block.shared_layout import MIN_VALUES, SCRATCH_ROWS
from sdm.kernels.dense.block.voxels import NEAR_ENDS, Block, end_reading, read_windings, write_coordinates, write_voxels
from sdm.kernels.dense.block.winners import NO_WINNERS
from sdm.kernels.dense.chunk_pool import (
    CandidateLists,
    ChunkPool,
    Reader,
    list_length,
    read_entry,
    read_on,
    start_reading,
)
from sdm.kernels.geometry.voxel_grid import Output, Slab
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import GPU_GROUPS, ballot, members, wait_for_block, wait_for_lanes

wp.set_module_options({"enable_backward": False})


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    return {GPU_GROUPS};
#else
    return 1;
#endif
"""
)
def groups_together() -> int:
    """Groups of lanes of a thread block."""
    ...


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    __shared__ float4 shared[{GPU_GROUPS} * {SCRATCH_ROWS}];
    return (wp::uint64)(shared + group * {SCRATCH_ROWS});
#else
    return (wp::uint64)(scratch.data + 4 * (size_t)worker * {SCRATCH_ROWS});
#endif
"""
)
def scratch_of_group(scratch: wp.array(dtype=wp.float32), worker: int, group: int) -> wp.uint64:
    """The address of a group's rows of four floats, see `shared_layout`; on a CPU of a worker's."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    return blockIdx.x;
#else
    return __atomic_fetch_add(counts.data + index, 1, __ATOMIC_RELAXED);
#endif
"""
)
def first_together(counts: wp.array(dtype=wp.int32), index: int) -> int:
    """The first item of a thread block: as many as there are have theirs from the start."""
    ...


@wp.func_native(
    snippet="""
#if defined(__CUDA_ARCH__)
    const int blocks = gridDim.x;
    if (total <= blocks) return total;
    __shared__ int next;
    __syncthreads();
    if (threadIdx.x == 0) next = blocks + atomicAdd(counts.data + index, 1);
    __syncthreads();
    return next;
#else
    return __atomic_fetch_add(counts.data + index, 1, __ATOMIC_RELAXED);
#endif
"""
)
def next_together(counts: wp.array(dtype=wp.int32), index: int, total: int) -> int:
    """The next of `total` items; that many or more if there is none left.

    All threads of a block come here, and none begins with it before all have ended the one before.
    """
    ...


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    constexpr int GROUPS = {GPU_GROUPS};
    __shared__ int counts[3 * GROUPS], sorted[32 * GROUPS];
    const int group = threadIdx.x / 32, lane = threadIdx.x % 32;
    const int number = feature & 7, kind = feature < 0 ? 3 : number < 3 ? 0 : number < 6 ? 1 : 2;
    const unsigned corners = __ballot_sync(0xffffffffu, kind == 0), edges = __ballot_sync(0xffffffffu, kind == 1);
    const unsigned faces = __ballot_sync(0xffffffffu, kind == 2);
    if (lane < 3) counts[GROUPS * lane + group] = __popc(lane == 0 ? corners : lane == 1 ? edges : faces);
    __syncthreads();
    int before = __popc((kind == 0 ? corners : kind == 1 ? edges : faces) & ((1u << lane) - 1u)), total = 0;
    #pragma unroll
    for (int i = 0; i < 3 * GROUPS; ++i) {{
        before += i < GROUPS * kind + group ? counts[i] : 0;
        total += counts[i];
    }}
    if (kind < 3) sorted[before] = feature;
    __syncthreads();
    const int each = (total + GROUPS - 1) / GROUPS, at = group * each + lane;
    return lane < each && at < total ? sorted[at] : -1;
#else
    return feature;
#endif
"""
)
def share_of_sorted(feature: int) -> int:
    """A lane's feature of those that all lanes of a thread block have, corners before edges before faces.

    -1 is none; each group gets as many, its first lanes. All threads of a block come here.
    """
    ...


@wp.func_native(
    snippet=f"""
    const int* at = reinterpret_cast<const int*>(scratch) + {MIN_VALUES} + 4 * row;
#if defined(__CUDA_ARCH__)
    int4 least = *reinterpret_cast<const int4*>(at);
    #pragma unroll
    for (int group = 1; group < {GPU_GROUPS}; ++group) {{
        const int4 other = *reinterpret_cast<const int4*>(at + 4 * {SCRATCH_ROWS} * group);
        least = make_int4(min(least.x, other.x), min(least.y, other.y), min(least.z, other.z), min(least.w, other.w));
    }}
    *reinterpret_cast<int4*>(const_cast<int*>(at)) = least;
#endif
"""
)
def keep_least_of_groups(scratch: wp.uint64, row: int):
    """Bring down four of the first group's values to the least of all groups', in the order of `min_values`."""
    ...


@wp.func
def measure_together(
    tree: Tree,
    features: Features,
    slab: Slab,
    pool: ChunkPool,
    blocks: CandidateLists,
    item: int,
    scratch: wp.array(dtype=wp.float32),
    out: Output,
    block: Block,
    octants: int,
    shares: int,
    thread: int,
    lanes: int,
):
    """`measuring.measure_block` of all octants, by all threads of a thread block."""
    groups = groups_together()
    lane = thread % lanes
    worker = thread / lanes
    group = worker % groups
    member = group * lanes + lane
    own = scratch_of_group(scratch, worker, group)
    # What all write in the end is in the first one's.
    first = scratch_of_group(scratch, worker, 0)
    write_coordinates(tree, slab, own, block, lane, lanes)
    clear_values(own, lane, lanes)
    read_windings(slab, out, first, block, octants, 1, member, groups * lanes)
    room = NEAR_ENDS * (block.box.half[0] + block.box.half[1] + block.box.half[2])
    reader = Reader()
    if list_length(blocks, item * shares, shares) >= 0:
        reader = start_reading(blocks, item * shares, shares)
    wait_for_lanes()
    while reader.left > 0:
        feature = int(-1)
        turn = int(0)
        while turn < groups and reader.left > 0:
            if turn == group:
                feature = read_entry(pool, reader, lane)
            reader = read_on(pool, blocks, reader, lanes)
            turn = turn + 1
        feature = share_of_sorted(feature)
        number = feature & 7
        which = wp.where(number < 3, CORNER_KIND, wp.where(number < 6, EDGE_KIND, FACE_KIND))
        batch = FeatureBatch()
        batch.features = members(ballot(feature >= 0))
        batch.corners = members(ballot(feature >= 0 and which == CORNER_KIND))
        batch.edges = members(ballot(feature >= 0 and which == EDGE_KIND))
        there = int(0)
        if feature >= 0:
            code = 4 * (feature >> 3) + number - 3 * which
            a, b, c, normal = load_corners(tree, code / 4)
            if which == CORNER_KIND:
                add_corner(own, lane, a, b, c, features, code, block.box, block.floor)
            elif which == EDGE_KIND:
                add_edge(own, lane, a, b, c, normal, features, code, block.box, block.floor)
            else:
                add_face(own, lane, a, b, c, normal, features, code, block.box, block.floor)
            there = octants & octants_of(own, lane, tests_of(which))
        wait_for_lanes()
        measure_features(own, batch, there, room, block.floor == 0.0, slab.turned != 0, NO_WINNERS, lane, lanes)
        wait_for_lanes()
    end_reading()
    wait_for_block()
    row = member
    while row < 1 << (3 * block.bits - 2):
        keep_least_of_groups(first, row)
        row = row + groups * lanes
    wait_for_block()
    unclear = write_voxels(slab, out, first, block, octants, 1, True, member, groups * lanes)
    if unclear > 0:
        fetch_add(out.ambiguous, block.mesh, unclear)
