"""Volumes with their axes in reverse, of sizes below, at and beyond those of a piece."""

from __future__ import annotations

import numpy as np
import pytest

from sdm.core.axis_order import LINE, PIECE, reversed_axes


@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (5, 1, 7), (0, 3, 2), (LINE + 3, 2, 5), (3, 70, 300), (2, 3, PIECE + 1), (64, 64, 64)]
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint8])
def test_is_the_transpose(shape, dtype):
    values = np.random.default_rng(0).integers(0, 200, shape).astype(dtype)
    found = reversed_axes(values)
    assert found.flags.c_contiguous
    assert found.dtype == dtype
    assert np.array_equal(found, values.T)
    assert np.array_equal(reversed_axes(found), values)


def test_goes_into_what_is_given_from_some_layers():
    values = np.arange(4 * 5 * 9, dtype=np.float32).reshape(4, 5, 9)
    room = np.full((10, 5, 4), -1, np.float32)
    assert reversed_axes(values[:, :, 2:6], room[3:7]).base is room
    assert np.array_equal(room[3:7], values.T[2:6])
    assert (room[:3] == -1).all()
    assert (room[7:] == -1).all()
