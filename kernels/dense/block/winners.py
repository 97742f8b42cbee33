"""Winners: the feature that each voxel's distance is from, noted where closest points are wanted beside distances.

Stage 6 is written once. What it does otherwise where winners are wanted is here, function by function: their last
argument but two is an array of winners, or `NO_WINNERS`.

A winner is 8 * slot + number, which is 0 to 2 for a corner, 3 to 5 for an edge, 6 for the face; or `SEARCHED` if a
search found the triangle, and not which part of it. Of features at the same distance, in float32, it is the least.

The winners take the place of the winding numbers in the scratch memory, which are read in the end. On a GPU values are
lessened as without them. Once all lanes have done that, one lane knows of each value that it was its own that lessened
it last, and writes its winner; then those that came to the same value lessen that. On a CPU it is a loop over vectors.

In place of winners there may be a `BlockOutput`: then distances go to the blocks of a narrow band.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.dense.block.feature_setup import CORNER_KIND, EDGE_KIND
from sdm.kernels.dense.block.min_values import clear_values, item_text, measure_item, two_at, values_of
from sdm.kernels.dense.block.shared_layout import BATCH, MIN_VALUES, SCRATCH_ROWS, WINDING, scratch_of, write_row
from sdm.kernels.dense.block.voxels import (
    Block,
    distance_of,
    fetch_windings,
    twos_of,
    voxel_index,
    write_two,
    write_voxels,
)
from sdm.kernels.geometry.block_table import BlockTable, inner_of, place_of
from sdm.kernels.geometry.voxel_box import is_within
from sdm.kernels.geometry.voxel_grid import Output, Slab, distances_at, is_unclear, with_sign
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import GPU_GROUPS

wp.set_module_options({"enable_backward": False})

NO_WINNERS = 0
# Numbers of the features of a batch, after all else.
_CODES = 4 * SCRATCH_ROWS
WINNER_ROWS = SCRATCH_ROWS + BATCH // 4
# Values and winners, side by side.
_FIRST_ROW, _ROWS = MIN_VALUES // 4, 256


@wp.struct
class BlockOutput:
    """Blocks of a narrow band, to which the distances of their voxels go."""

    table: BlockTable
    values: wp.array(dtype=wp.float32)  # (N * 512) winding numbers before, signed distances after
    near: wp.array(dtype=wp.int32)  # (N) zero before, 1 for blocks with a voxel that is nearer than:
    width: float  # at most so far from zero are the distances that are written
    shifts: wp.vec3i  # along each axis the blocks have one of 2^shift measured voxels, from the first on


# A voxel of a block that was missed: minus that inside. Without an end where its winding number is clear.
MISSED = 3.0e38


@wp.func
def put_in_block(to: BlockOutput, place: int, number: int, distance: float):
    """Write a distance, clamped and with its sign; 1 if it is near and its winding number unclear."""
    index = 512 * place + number
    winding = to.values[index]
    if not distance < float(wp.inf):
        to.values[index] = with_sign(wp.where(is_unclear(winding) != 0, MISSED, float(wp.inf)), winding)
        return 0
    to.values[index] = with_sign(wp.min(distance, to.width), winding)
    if distance < to.width:
        to.near[place] = 1
        return is_unclear(winding)
    return 0


@wp.func
def first_kept(to: BlockOutput, start: wp.vec3i):
    """The first voxel of the blocks' grid that is not before a measured voxel."""
    s = to.shifts
    return wp.vec3i(
        (start[0] + (1 << s[0]) - 1) >> s[0], (start[1] + (1 << s[1]) - 1) >> s[1], (start[2] + (1 << s[2]) - 1) >> s[2]
    )


@wp.func
def block_place(to: BlockOutput, start: wp.vec3i):
    """The place of the block that has the voxels of a measured block, all of which lie in one; -1 for none."""
    at = first_kept(to, start)
    return place_of(to.table, wp.vec3i(at[0] >> 3, at[1] >> 3, at[2] >> 3))


@wp.func
def is_wanted(winners: int, start: wp.vec3i):
    """True if the block that starts at a voxel is to be measured."""
    return True


@wp.func
def is_wanted(winners: wp.array(dtype=wp.int32), start: wp.vec3i):  # noqa: F811
    return True


@wp.func
def is_wanted(winners: BlockOutput, start: wp.vec3i):  # noqa: F811
    return block_place(winners, start) >= 0


@wp.func
def worker_scratch(scratch: wp.array(dtype=wp.float32), worker: int, winners: int):
    """The address of a worker's rows of four floats."""
    return scratch_of(scratch, worker)


@wp.func
def worker_scratch(scratch: wp.array(dtype=wp.float32), worker: int, winners: BlockOutput):  # noqa: F811
    return scratch_of(scratch, worker)


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    __shared__ float4 shared[{GPU_GROUPS} * {WINNER_ROWS}];
    return (wp::uint64)(shared + threadIdx.x / 32 * {WINNER_ROWS});
#else
    return (wp::uint64)(scratch.data + 4 * (size_t)worker * {WINNER_ROWS});
#endif
"""
)
def worker_scratch(  # noqa: F811
    scratch: wp.array(dtype=wp.float32), worker: int, winners: wp.array(dtype=wp.int32)
) -> wp.uint64: ...


@wp.func
def begin_block(
    slab: Slab,
    out: Output,
    scratch: wp.uint64,
    block: Block,
    octants: int,
    parts: int,
    winners: int,
    lane: int,
    lanes: int,
):
    """No voxel of the block has a value yet; its winding numbers come nearer."""
    clear_values(scratch, lane, lanes)
    fetch_windings(slab, out, block, lane, lanes)


@wp.func
def begin_block(  # noqa: F811
    slab: Slab,
    out: Output,
    scratch: wp.uint64,
    block: Block,
    octants: int,
    parts: int,
    winners: BlockOutput,
    lane: int,
    lanes: int,
):
    clear_values(scratch, lane, lanes)


@wp.func
def begin_block(  # noqa: F811
    slab: Slab,
    out: Output,
    scratch: wp.uint64,
    block: Block,
    octants: int,
    parts: int,
    winners: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
):
    row = lane
    while row < _ROWS:
        write_row(scratch, _FIRST_ROW + row, float(wp.inf), float(wp.inf), float(wp.inf), float(wp.inf))
        row = row + lanes


@wp.func_native(snippet=f"reinterpret_cast<int*>(scratch)[{_CODES} + number] = code;")
def write_code(scratch: wp.uint64, number: int, code: int): ...


@wp.func
def note_feature(scratch: wp.uint64, number: int, kind: int, code: int, winners: int):
    """Note what feature `number` of a batch is: part code % 4 of this kind of triangle code / 4."""


@wp.func
def note_feature(scratch: wp.uint64, number: int, kind: int, code: int, winners: BlockOutput):  # noqa: F811
    pass


@wp.func
def note_feature(  # noqa: F811
    scratch: wp.uint64, number: int, kind: int, code: int, winners: wp.array(dtype=wp.int32)
):
    first = wp.where(kind == CORNER_KIND, 0, wp.where(kind == EDGE_KIND, 3, 6))
    write_code(scratch, number, 8 * (code / 4) + first + code % 4)


@wp.func
def measure_one(
    scratch: wp.uint64, item: int, kind: int, room: float, near: bool, turned: bool, taken: int, winners: int
):
    """`measure_item`; the first `taken` lanes all do it."""
    measure_item(scratch, item, kind, room, near, turned)


@wp.func
def measure_one(  # noqa: F811
    scratch: wp.uint64, item: int, kind: int, room: float, near: bool, turned: bool, taken: int, winners: BlockOutput
):
    measure_item(scratch, item, kind, room, near, turned)


_BOTH = f"""
    const int code = reinterpret_cast<const int*>(scratch)[{_CODES} + feature];
#if defined(__CUDA_ARCH__)
    const unsigned together = taken < 32 ? (1u << taken) - 1u : 0xffffffffu;
    int* best = reinterpret_cast<int*>(scratch) + {MIN_VALUES} + 64 * octant + 8 * in;
    int* codes = reinterpret_cast<int*>(scratch) + {WINDING} + 64 * octant + 8 * in;
#else
    float* __restrict best = reinterpret_cast<float*>(scratch) + {MIN_VALUES} + 64 * octant + 8 * in;
    int* __restrict codes = reinterpret_cast<int*>(scratch) + {WINDING} + 64 * octant + 8 * in;
#endif
"""
_KNOWN = """
            const int4 four = reinterpret_cast<const int4*>(best)[side];
            const int known[4] = {four.x, four.y, four.z, four.w};
            int mine[4];
            unsigned there = 0, lowered = 0;
"""
_KEEP = (
    """
                mine[v] = value;
                if (counts & (value <= known[v])) {
                    there |= 1u << v;
                    if (value < known[v] && atomicMin(best + 4 * side + v, value) > value) lowered |= 1u << v;
                }
    """,
    """
            __syncwarp(together);
            const int4 now = reinterpret_cast<const int4*>(best)[side];
            const int least[4] = {now.x, now.y, now.z, now.w};
            #pragma unroll
            for (int v = 0; v < 4; ++v) {
                if (mine[v] != least[v]) there &= ~(1u << v);
                if (there & lowered & (1u << v)) codes[4 * side + v] = code;
            }
            __syncwarp(together);
            #pragma unroll
            for (int v = 0; v < 4; ++v)
                if (there & ~lowered & (1u << v)) atomicMin(codes + 4 * side + v, code);
    """,
    """
                const int at = 4 * side + v;
                const bool wins = counts & ((d < best[at]) | ((d == best[at]) & (code < codes[at])));
                codes[at] = wins ? code : codes[at];
                best[at] = wins ? d : best[at];
    """,
)


@wp.func_native(snippet=item_text(_BOTH, _KNOWN, _KEEP))
def measure_one(  # noqa: F811
    scratch: wp.uint64,
    item: int,
    kind: int,
    room: float,
    near: bool,
    turned: bool,
    taken: int,
    winners: wp.array(dtype=wp.int32),
): ...


@wp.func_native(
    snippet=f"""
    const int* value = reinterpret_cast<const int*>(scratch) + {MIN_VALUES} + 2 * number;
    const int* code = reinterpret_cast<const int*>(scratch) + {WINDING} + 2 * number;
    return wp::vec4i(value[0], value[1], code[0], code[1]);
"""
)
def pair_of(scratch: wp.uint64, number: int) -> wp.vec4i:
    """The bits of the least values of the two voxels `number`, see `two_at`, and their winners."""
    ...


@wp.func_native(snippet="return *reinterpret_cast<const float*>(&bits);")
def as_float(bits: int) -> float: ...


@wp.func
def end_block(
    slab: Slab,
    out: Output,
    scratch: wp.uint64,
    block: Block,
    octants: int,
    parts: int,
    winners: int,
    lane: int,
    lanes: int,
):
    """Write what was found of all voxels of a measured block; returns how many have unclear winding numbers."""
    return write_voxels(slab, out, scratch, block, octants, parts, False, lane, lanes)


@wp.func
def end_block(  # noqa: F811
    slab: Slab,
    out: Output,
    scratch: wp.uint64,
    block: Block,
    octants: int,
    parts: int,
    winners: BlockOutput,
    lane: int,
    lanes: int,
):
    unclear = int(0)
    missed = int(0)
    place = block_place(winners, block.start)
    two = lane
    while two < twos_of(block):
        least = values_of(scratch, two)
        for second in range(2):
            v = block.start + two_at(two) + wp.vec3i(0, 0, second)
            at = first_kept(winners, v)
            s = winners.shifts
            mine = is_within(slab, v) and (parts == 1 or (octants >> (two >> 5) & 1) != 0)
            if mine and wp.vec3i(at[0] << s[0], at[1] << s[1], at[2] << s[2]) == v:
                distance = distance_of(block, least[second])
                missed = missed + wp.where(distance < float(wp.inf), 0, 1)
                unclear = unclear + put_in_block(winners, place, inner_of(at), distance)
        two = two + lanes
    if missed > 0:
        fetch_add(out.missed, 0, missed)
    return unclear


@wp.func
def end_block(  # noqa: F811
    slab: Slab,
    out: Output,
    scratch: wp.uint64,
    block: Block,
    octants: int,
    parts: int,
    winners: wp.array(dtype=wp.int32),
    lane: int,
    lanes: int,
):
    # As `write_voxels` does it: no list is cut into splits here.
    unclear = int(0)
    missed = int(0)
    address = distances_at(out)
    two = lane
    while two < twos_of(block):
        at = two_at(two)
        index = voxel_index(slab, block, at)
        if index >= 0 and (parts == 1 or (octants >> (two >> 5) & 1) != 0):
            found = pair_of(scratch, two)
            first = distance_of(block, as_float(found[0]))
            second = distance_of(block, as_float(found[1]))
            count = wp.min(2, slab.shape[2] - block.start[2] - at[2])
            winding = out.values[index]
            missed = missed + wp.where(first < float(wp.inf), 0, 1)
            unclear = unclear + is_unclear(winding)
            first = with_sign(first, winding)
            winners[index] = found[2]
            if count > 1:
                winding = out.values[index + 1]
                missed = missed + wp.where(second < float(wp.inf), 0, 1)
                unclear = unclear + is_unclear(winding)
                second = with_sign(second, winding)
                winners[index + 1] = found[3]
            write_two(address, index, first, second, count, slab.shape[2] % 2 == 0)
        two = two + lanes
    if missed > 0:
        fetch_add(out.missed, 0, missed)
    return unclear
