"""An anchor takes a surrogate's error out of what is rendered, exactly at one state and to first order around it."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from sdm import Grid, SDMError
from sdm.fit.model.anchor import Anchored
from sdm.fit.model.backend import exact_of
from sdm.fit.model.backends import make_backends
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State
from sdm.fit.model.spline_backend import GridBackend
from sdm.shapes import Parameter

MAPS = Grid((-2.4, -2.4, -2.4), (0.2, 0.2, 0.2), (25, 25, 25))
IMAGE = Grid((-2.1, -2.1, -2.1), (0.3, 0.3, 0.3), (15, 15, 15))
PARAMETERS = (Parameter("r", 0.5, 2.0, "mm"), Parameter("x", -0.5, 0.5, "mm"))


def ball(theta: Tensor) -> Tensor:
    """Distances to balls of radius theta[:, 0] about (theta[:, 1], 0, 0)."""
    centre = torch.stack([theta[:, 1], 0 * theta[:, 1], 0 * theta[:, 1]], 1)
    return ((MAPS.points() - centre[:, None, None, None]).norm(dim=-1) - theta[:, 0, None, None, None])[:, None]


def biased(theta: Tensor) -> Tensor:
    """The same with an error that depends on place and shape."""
    return ball(theta) + (0.02 + 0.1 * theta[:, :1, None, None, None]) * torch.sin(3 * MAPS.points()[..., 0])


def _renderer(backend: GridBackend) -> Renderer:
    return Renderer(IMAGE, backend, blur=0.2, length=0.03, fine=0.15)


def _state(radius: float, place: float) -> State:
    theta = torch.tensor([radius, place], dtype=torch.float64)
    zero = torch.zeros(3, dtype=torch.float64)
    return State(theta, torch.eye(3, dtype=torch.float64), zero + 0.05, zero)


def test_exact_at_the_anchor_and_to_first_order_around_it() -> None:
    true, plain = GridBackend(ball, MAPS, PARAMETERS), GridBackend(biased, MAPS, PARAMETERS, slack=0.3)
    exact, surrogate, anchor = _renderer(true), _renderer(plain), _state(1.2, 0.1)
    anchored = Anchored(surrogate, exact, anchor)
    assert true.evaluations == 1
    right, there = exact(anchor), anchored(anchor)
    assert right.by_step is not None
    assert there.by_step is not None
    assert torch.equal(there.share, right.share)
    assert torch.equal(there.by_step, right.by_step)
    direction = torch.tensor([0.4, -0.3, 0.1, 0.2, -0.1, 0.3, -0.2, 0.2], dtype=torch.float64)
    errors = []
    for length in (0.05, 0.025):
        near = anchor.moved(length * direction)
        wanted, found = exact(near).share, anchored(near)
        assert found.by_step is there.by_step
        assert found.share.min() >= 0
        assert found.share.max() <= 1
        errors.append(float((found.share - wanted).abs().mean()))
        assert errors[-1] < 0.02 * float((surrogate(near).share - wanted).abs().mean())
    # Half the way, a quarter of the error.
    assert errors[1] < 0.35 * errors[0]


def test_increments_between_states() -> None:
    anchor = _state(1.2, 0.1).moved(torch.tensor([0.1, 0.0, 0.4, -0.3, 0.2, 0.1, -0.2, 0.3], dtype=torch.float64))
    step = torch.tensor([0.2, -0.1, 0.3, 0.5, -0.4, 0.2, 0.1, -0.3], dtype=torch.float64)
    assert torch.allclose(anchor.moved(step).since(anchor), step, atol=1e-12)


def test_which_backends_have_an_anchor() -> None:
    true = GridBackend(ball, MAPS, PARAMETERS)
    assert exact_of(true) is None
    assert exact_of(GridBackend(biased, MAPS, PARAMETERS, exact=true)) is true
    exact = make_backends("exact", triangles=2_000, device="cpu")[0]
    assert exact_of(exact) is None
    surrogate, finish = make_backends("hybrid", triangles=2_000, device="cpu")
    assert exact_of(surrogate) is finish
    with pytest.raises(SDMError, match="other parameters"):
        GridBackend(biased, MAPS, PARAMETERS, exact=exact)
