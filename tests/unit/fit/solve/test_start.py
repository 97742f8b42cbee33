"""The start on coarser meshes, and torch's threads while a fit runs."""

from __future__ import annotations

import pytest
import torch

from sdm.core.grid import Grid
from sdm.fit import ExactBackend
from sdm.fit.model.backend import rough_of
from sdm.fit.model.spline_backend import GridBackend
from sdm.runtime.threads import SMALLEST_SHARED, one_thread_for
from sdm.shapes import Cochlea, Parameter

THETA = torch.tensor([3.6, 0.5, 0.14, -0.2], dtype=torch.float64)
CPU = torch.device("cpu")


def test_the_rough_backend_is_near_and_turns_about_the_same_point() -> None:
    backend = ExactBackend(Cochlea(20_000), "cpu")
    rough = rough_of(backend)
    assert isinstance(rough, ExactBackend)
    assert rough.faces.shape[0] * 5 < backend.faces.shape[0]
    assert torch.equal(rough.centre, backend.centre)
    assert rough.name != backend.name
    points = (torch.rand(500, 3, generator=torch.Generator().manual_seed(0)).double() - 0.5) * 8
    away = (rough.distances(THETA, points) - backend.distances(THETA, points)).abs().max()
    # A tenth of the coarse image's voxel.
    assert 0 < float(away) < 0.06


def test_backends_without_a_rough_one_stay() -> None:
    coarse = ExactBackend(Cochlea(1_000), "cpu")
    assert rough_of(coarse) is coarse
    grid = Grid((-1.0,) * 3, (0.5,) * 3, (8, 8, 8))
    maps = GridBackend(lambda t: t, grid, (Parameter("r", 0.5, 2.0, "mm"),))
    assert rough_of(maps) is maps


def test_threads_come_back_even_after_an_error() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with pytest.raises(ValueError, match="stop"), one_thread_for(1_000, CPU):
            assert torch.get_num_threads() == 1
            raise ValueError("stop")
        assert torch.get_num_threads() == 2
        with one_thread_for(SMALLEST_SHARED, CPU):
            assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
