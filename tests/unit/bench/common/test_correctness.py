"""Signs that are compared: those that a fraction of a rounding does not turn."""

from __future__ import annotations

import numpy as np
import pytest

from sdm.bench.common.correctness import INSIDE, firm_winding, rounding
from sdm.bench.common.meshes import Case
from sdm.bench.common.oracles.brute_force import Brute


@pytest.fixture
def sheet():
    """A square: the winding number is one half right below it and falls by one around each edge."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    return Case("sheet", vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), frozenset())


def test_beside_an_edge_and_away_from_it(sheet):
    winding_number = Brute(sheet.vertices, sheet.faces).winding_number

    def thrice(points):
        # Half is then a third of the way around the edge.
        return 3 * winding_number(points)

    unit = float(rounding(sheet, np.zeros((1, 3), np.float32))[0])
    # Around the edge at x = 0, y = 0.5 the turn from the sheet's plane at which the winding number is a sixth.
    turn = 2 * np.pi / 3

    def around(radius, off):
        return np.array([[np.cos(turn + off) * radius, 0.5, -np.sin(turn + off) * radius]])

    # Two hundredths of a turn are less than a quarter of a rounding at a rounding's distance, and more at a hundred.
    for off in (-0.1, 0.1):
        assert firm_winding(sheet, around(unit, off), thrice) == INSIDE
        away = around(100 * unit, off)
        np.testing.assert_array_equal(firm_winding(sheet, away, thrice), thrice(away))
        assert (thrice(away) > INSIDE) == (off < 0)
