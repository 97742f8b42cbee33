"""Rows of four floats that one thread writes while another reads them."""
# pyright: reportInvalidTypeForm=false, reportOperatorIssue=false, reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

import threading

import warp as wp

from sdm.kernels.launch import by_this_thread, launch
from sdm.kernels.primitives.lanes import unknown
from sdm.kernels.primitives.vector_loads import read4, write4


@wp.kernel(enable_backward=False)
def _write_rows(begin: int, turns: int, rows: wp.array(dtype=wp.float32)):
    for turn in range(turns):
        row = float(turn & 1023)
        write4(rows, unknown(begin), row, row, row, row)


@wp.kernel(enable_backward=False)
def _read_rows(begin: int, turns: int, rows: wp.array(dtype=wp.float32), torn: wp.array(dtype=wp.int32)):
    for _turn in range(turns):
        row = read4(rows, unknown(begin))
        if row[0] != row[3] or row[1] != row[3] or row[2] != row[3]:
            torn[0] = torn[0] + 1


def test_a_row_is_read_as_it_was_before_or_after_it_was_written():
    """Splits of a list read and write the witness of one brick: three numbers of one and one of another are no point of
    the surface, and values were wrong by it where the system stopped a thread between two of its reads.
    """
    rows, torn = wp.zeros(4, dtype=wp.float32, device="cpu"), wp.zeros(1, dtype=wp.int32, device="cpu")
    done = threading.Event()

    def write() -> None:
        with by_this_thread():
            while not done.is_set():
                launch(_write_rows, 1, [100_000, rows], "cpu")

    launch(_write_rows, 1, [1, rows], "cpu")
    launch(_read_rows, 1, [1, rows, torn], "cpu")
    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(600):
            launch(_read_rows, 1, [30_000, rows, torn], "cpu")
    finally:
        done.set()
        writer.join()
    assert rows.numpy().max() > 0
    assert torn.numpy()[0] == 0
