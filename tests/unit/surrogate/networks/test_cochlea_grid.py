"""The grid holds the whole family, with room."""

from __future__ import annotations

import torch

from sdm.shapes import Cochlea
from sdm.surrogate.networks.cochlea_grid import GRID

ROOM_MM = 0.8


def test_every_shape_lies_in_the_grid_with_room():
    low, high = Cochlea(2000).bounds()
    first = torch.tensor(GRID.origin)
    last = first + torch.tensor(GRID.spacing) * (torch.tensor(GRID.shape) - 1)
    assert (low - first).min() >= ROOM_MM - 0.02
    assert (last - high).min() >= ROOM_MM - 0.02
    # Not more than is needed: a grid of this size may be requested on every call.
    assert (low - first).max() < 1.3
    assert (last - high).max() < 1.3


def test_voxels_are_a_fifth_of_a_millimetre_and_halve_three_times():
    assert GRID.spacing == (0.2, 0.2, 0.2)
    assert all(n % 8 == 0 for n in GRID.shape)
