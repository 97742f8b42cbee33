"""Cells whose lists one group of lanes makes side by side: what it knows of each, at hand for all lanes.

Of each cell there are four rows of four floats: its box (centre, half^2; half-widths, diagonal), its witness, and the
chain that it has so far, whole numbers bit for bit.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.cull import Cell, Witness, cell_of_rows, witness_of_row
from sdm.kernels.lanes import GPU_GROUPS
from sdm.kernels.lists import Chain
from sdm.kernels.rows import read_row, write_row
from sdm.kernels.stacks import STACK

wp.set_module_options({"enable_backward": False})

# Cells at most, those of a region, and rows of each.
CELLS, CELL_ROWS = 8, 4
_CELL_ROWS = wp.constant(CELL_ROWS)


@wp.func_native(
    snippet=f"""
#if defined(__CUDA_ARCH__)
    __shared__ float4 shared[{GPU_GROUPS} * {CELLS * CELL_ROWS}];
    return (wp::uint64)(shared + threadIdx.x / 32 * {CELLS * CELL_ROWS});
#else
    return (wp::uint64)(stacks.data + (size_t)worker * {STACK});
#endif
"""
)
def notes_of(stacks: wp.array(dtype=wp.int32), worker: int) -> wp.uint64:
    """The address of a worker's rows: on a GPU in shared memory, else in its stack."""
    ...


@wp.func
def note_box(notes: wp.uint64, i: int, cell: Cell):
    """Note the box of the i-th cell."""
    c = cell.centre
    h = cell.half
    write_row(notes, _CELL_ROWS * i, c[0], c[1], c[2], cell.half2)
    write_row(notes, _CELL_ROWS * i + 1, h[0], h[1], h[2], cell.diagonal)


@wp.func
def note_state(notes: wp.uint64, i: int, known: Witness, chain: Chain):
    """Note what is known of the i-th cell by now."""
    u = known.to_surface
    write_row(notes, _CELL_ROWS * i + 2, u[0], u[1], u[2], known.distance2)
    chunk = wp.cast(chain.chunk, wp.float32)
    fill = wp.cast(chain.fill, wp.float32)
    write_row(notes, _CELL_ROWS * i + 3, chunk, fill, wp.cast(chain.length, wp.float32), 0.0)


@wp.func
def noted_box(notes: wp.uint64, i: int):
    return cell_of_rows(read_row(notes, _CELL_ROWS * i), read_row(notes, _CELL_ROWS * i + 1))


@wp.func
def noted_state(notes: wp.uint64, i: int):
    known = witness_of_row(read_row(notes, _CELL_ROWS * i + 2))
    row = read_row(notes, _CELL_ROWS * i + 3)
    chain = Chain()
    chain.chunk = wp.cast(row[0], wp.int32)
    chain.fill = wp.cast(row[1], wp.int32)
    chain.length = wp.cast(row[2], wp.int32)
    return known, chain
