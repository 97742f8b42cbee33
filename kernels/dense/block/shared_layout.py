"""Layout of a worker's memory while it measures a block: on a GPU shared memory, ten times nearer.

Up to 32 features of one kind are worked out at a time, one a lane. Of each there are up to four rows of four floats
that measure it, see `feature_setup`: corner (-m, w); edge (-m, w) (e, where it begins along it); face (n, -m.n) and
three planes (inward, height); and up to six that tell where it can matter (u, limit), see `octant_tests`. Every
feature's first rows lie side by side, then their second ones, so that lanes do not wait for each other. Then come the
block's lattice and its witness; single numbers: where each edge ends, or w of each face, 24 coordinates of voxels, the
least value of each of 512 voxels; the queues of `work_queues`; the block itself, whose numbers would else be in
registers of every lane; and the winding numbers of its voxels, or their winners.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.lanes import GPU_GROUPS

wp.set_module_options({"enable_backward": False})

# Features worked out at a time; rows that measure each, and rows that test it.
BATCH, VALUE_ROWS, TESTS = 32, 4, 6
TEST_ROW = VALUE_ROWS * BATCH
LATTICE_ROW = TEST_ROW + TESTS * BATCH
WITNESS_ROW = LATTICE_ROW + 4
NUMBERS = 4 * (WITNESS_ROW + 1)
COORDINATES = NUMBERS + BATCH
MIN_VALUES = COORDINATES + 24
# Octants of the features, and eighths of those: bytes and numbers of 16 bits.
PAIRS = 4 * (MIN_VALUES + 512)
MOST_PAIRS, MOST_ITEMS = 8 * BATCH, 384
ITEMS = PAIRS + MOST_PAIRS * 2
BLOCK_ROW = (ITEMS + 2 * MOST_ITEMS) // 16
BLOCK_ROWS = 4
# What those have that need no winding numbers here, and what the others have.
FEWER_ROWS = BLOCK_ROW + BLOCK_ROWS
WINDING = 4 * FEWER_ROWS
SCRATCH_ROWS = FEWER_ROWS + 128


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    __shared__ float4 shared[{GPU_GROUPS} * {FEWER_ROWS}];
    return (wp::uint64)(shared + threadIdx.x / 32 * {FEWER_ROWS});
#else
    return (wp::uint64)(scratch.data + 4 * (size_t)worker * {SCRATCH_ROWS});
#endif
"""
)
def scratch_of(scratch: wp.array(dtype=wp.float32), worker: int) -> wp.uint64:
    """The address of a worker's rows of four floats; on a GPU there is no room for winding numbers."""
    ...


@wp.func_native(
    snippet="""
    struct alignas(16) Row { float x, y, z, w; };
    reinterpret_cast<Row*>(scratch)[index] = Row{x, y, z, w};
"""
)
def write_row(scratch: wp.uint64, index: int, x: float, y: float, z: float, w: float): ...


@wp.func_native(
    snippet="""
    struct alignas(16) Row { float x, y, z, w; };
    const Row row = reinterpret_cast<const Row*>(scratch)[index];
    return wp::vec4(row.x, row.y, row.z, row.w);
"""
)
def read_row(scratch: wp.uint64, index: int) -> wp.vec4: ...


@wp.func_native(snippet="reinterpret_cast<float*>(scratch)[index] = value;")
def write_float(scratch: wp.uint64, index: int, value: float): ...


@wp.func_native(
    snippet="""
    struct alignas(16) Row { int x, y, z, w; };
    reinterpret_cast<Row*>(scratch)[index] = Row{x, y, z, w};
"""
)
def write_whole_row(scratch: wp.uint64, index: int, x: int, y: int, z: int, w: int): ...


@wp.func_native(
    snippet="""
    struct alignas(16) Row { int x, y, z, w; };
    const Row row = reinterpret_cast<const Row*>(scratch)[index];
    return wp::vec4i(row.x, row.y, row.z, row.w);
"""
)
def read_whole_row(scratch: wp.uint64, index: int) -> wp.vec4i: ...
