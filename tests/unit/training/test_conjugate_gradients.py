"""Conjugate gradients against a direct solution."""

from __future__ import annotations

import pytest
import torch

from sdm.training.conjugate_gradients import conjugate_gradients

ROOT = torch.randn(8, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
MATRIX, RIGHT = ROOT @ ROOT.T + torch.eye(8), torch.arange(8.0, dtype=torch.float64)


@pytest.mark.parametrize("preconditioner", [None, lambda x: x / MATRIX.diagonal()])
def test_they_solve_in_as_many_steps_as_there_are_unknowns(preconditioner):
    found = conjugate_gradients(lambda x: MATRIX @ x, RIGHT, 12, preconditioner=preconditioner)
    torch.testing.assert_close(found, torch.linalg.solve(MATRIX, RIGHT), rtol=1e-6, atol=1e-8)


def test_they_end_where_little_is_left():
    asked = []

    def product(x: torch.Tensor) -> torch.Tensor:
        asked.append(x)
        return MATRIX @ x

    found = conjugate_gradients(product, RIGHT, 12, accuracy=0.1)
    assert 0 < len(asked) < 8
    assert float((MATRIX @ found - RIGHT).norm() / RIGHT.norm()) < 0.1


def test_nothing_to_solve_is_no_division_by_zero():
    for dtype in (torch.float32, torch.float64):
        assert not conjugate_gradients(lambda x: x, torch.zeros(3, dtype=dtype), 5).any()
