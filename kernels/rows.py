"""Where a worker notes the parts that it measures a block from: on a GPU in shared memory, ten times nearer.

Rows of four floats: corners (-2m, w); edges (-2m, w) (e, where it begins along it); faces (n, 2h) and three planes
(inward, height), see `features`; the block's lattice, see `octants`. All parts' first rows lie behind each other, then
their second ones, so that lanes do not wait for each other. Then single numbers: where each edge ends, w of each face,
24 coordinates of voxels. Then bytes: for each part one bit for each octant that it matters to.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# Room of each list: what waits for a batch of lanes must fit into empty ones.
FACES, EDGES, CORNERS = 64, 112, 112
EDGE_ROW = CORNERS
FACE_ROW = EDGE_ROW + 2 * EDGES
LATTICE_ROW = FACE_ROW + 4 * FACES
ENDS = 4 * (LATTICE_ROW + 4)
OFFSETS = ENDS + EDGES
PLACES = OFFSETS + FACES
CORNER_BITS = 4 * (PLACES + 24)
EDGE_BITS = CORNER_BITS + CORNERS
FACE_BITS = EDGE_BITS + EDGES
ROWS = (FACE_BITS + FACES) // 16
# Blocks of threads have four groups of lanes.
_GROUPS = 4


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    __shared__ float4 shared[{_GROUPS} * {ROWS}];
    return (wp::uint64)(shared + threadIdx.x / 32 * {ROWS});
#else
    return (wp::uint64)(rows.data + 4 * (size_t)worker * {ROWS});
#endif
"""
)
def rows_of(rows: wp.array(dtype=wp.float32), worker: int) -> wp.uint64:
    """The address of a worker's rows."""
    ...


@wp.func_native(
    snippet="""
    struct alignas(16) Row { float x, y, z, w; };
    reinterpret_cast<Row*>(rows)[index] = Row{x, y, z, w};
"""
)
def write_row(rows: wp.uint64, index: int, x: float, y: float, z: float, w: float): ...


@wp.func_native(snippet="reinterpret_cast<float*>(rows)[index] = value;")
def write_number(rows: wp.uint64, index: int, value: float): ...


@wp.func_native(snippet="return reinterpret_cast<const float*>(rows)[index];")
def read_number(rows: wp.uint64, index: int) -> float: ...


@wp.func_native(snippet="reinterpret_cast<unsigned char*>(rows)[index] = (unsigned char)value;")
def write_byte(rows: wp.uint64, index: int, value: int): ...
