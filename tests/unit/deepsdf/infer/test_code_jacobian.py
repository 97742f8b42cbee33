"""Products by cells are those of the whole matrix, and what is nearly an inverse is one where no blur mixes points."""

from __future__ import annotations

import pytest
import torch

from sdm.deepsdf import local, published
from sdm.deepsdf.infer import preconditioner
from sdm.deepsdf.infer.code_jacobian import RUN, CodeJacobian
from sdm.deepsdf.infer.preconditioner import Preconditioner
from sdm.deepsdf.networks.code_gaussian import CodeGaussian
from sdm.deepsdf.networks.decoders import make_decoder

SETTINGS = [
    local(width=16, global_size=8, grids=((3, 2), (5, 3))),
    local(width=16, global_size=8, grids=()),
    published(width=32, global_size=8),
]
POINTS = 5 * RUN


@pytest.fixture(params=SETTINGS, ids=["grids", "whole", "published"])
def made(request):
    """A matrix by cells, and the whole one: some points at a corner of the box, and more in a cell than a run holds."""
    decoder = make_decoder(request.param)
    random = torch.Generator().manual_seed(0)
    points = torch.rand(POINTS, 3, generator=random) * 2 - 1
    points[: 2 * RUN] *= 0.02
    points[-1], points[-2] = 1.0, -1.0
    parts = [decoder.global_size, *([sum(c for _, c in decoder.grids)] if decoder.grids else [])]
    by_seen = tuple(torch.randn(POINTS, part, generator=random) for part in parts)
    return CodeJacobian(decoder, by_seen, points), decoder.rows(by_seen, points), random


def test_products(made) -> None:
    rows, dense, random = made
    code, pull = torch.randn(dense.shape[1], generator=random), torch.randn(POINTS, generator=random)
    torch.testing.assert_close(rows.forward(code), dense @ code, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(rows.backward(pull), dense.T @ pull, atol=1e-4, rtol=1e-4)


def test_products_of_columns(made) -> None:
    rows, dense, random = made
    seen = torch.zeros(dense.shape[1], dtype=torch.bool)
    seen[rows.columns().flatten()] = True
    assert not bool(dense[:, ~seen].any())
    others, importance = torch.randn(POINTS, 7, generator=random), torch.rand(POINTS, generator=random)
    importance[::3] = 0
    torch.testing.assert_close(rows.squares(importance), importance @ dense.square(), atol=1e-4, rtol=1e-4)
    for left_out in (0, 3):
        kept = seen.nonzero()[left_out:, 0]
        column = torch.full((len(seen),), len(kept))
        column[kept] = torch.arange(len(kept))
        found = rows.gram(column, len(kept), others, importance)
        whole = torch.cat([dense[:, kept], others], 1)
        torch.testing.assert_close(found, whole.T @ (importance[:, None] * whole), atol=1e-3, rtol=1e-3)


def test_an_inverse(made, monkeypatch) -> None:
    monkeypatch.setattr(preconditioner, "LEAST", 0.0)
    rows, dense, random = made
    size = dense.shape[1]
    # Few codes of many numbers, along which shapes vary more than else.
    gaussian = CodeGaussian(torch.randn(4, size, generator=random), 1.0, share=0.5)
    similar, importance = torch.randn(POINTS, 7, generator=random).double(), torch.rand(POINTS, generator=random)
    even = torch.randn(20, size, generator=random), torch.randn(20, 7, generator=random).double()
    # Numbers of a code that only these rows see, and such that none sees.
    even[0][:, -3:] = 0
    inverse = Preconditioner(gaussian, rows, similar, importance, even)

    def standard(rows: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
        return torch.cat([torch.stack([gaussian.spread(row) for row in rows]).double(), others], 1)

    whole, own = standard(dense, similar), standard(*even)
    matrix = whole.T @ (importance.double()[:, None] * whole) + own.T @ own + torch.eye(size + 7)
    right = torch.randn(size + 7, generator=random, dtype=torch.float64)
    torch.testing.assert_close(inverse(right), torch.linalg.solve(matrix, right), atol=1e-3, rtol=1e-3)
