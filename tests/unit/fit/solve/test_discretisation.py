"""Errors of facets and sample points: the correction against meshes and points that are finer still."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

import sdm
from sdm.fit import ExactBackend, FitOptions, State
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.solve.fit_shape import renderer_of
from sdm.fit.solve.formation.discretisation import Discretisation, discretisation
from sdm.shapes import Cochlea, StatisticalShape


@pytest.fixture(scope="module")
def backend() -> ExactBackend:
    return ExactBackend(Cochlea(1_000), "cpu")


def middle(backend: ExactBackend) -> State:
    theta = torch.tensor([(p.low + p.high) / 2 for p in backend.parameters], dtype=torch.float64)
    return State(theta, torch.eye(3).double(), torch.zeros(3).double(), backend.centre)


def test_the_correction_takes_most_of_the_error_out(backend: ExactBackend):
    grid, options, state = (
        sdm.Grid((-6.0, -5.6, -3.2), (0.8,) * 3, (16, 15, 9)),
        FitOptions(blur=0.4, fine=0.4),
        middle(backend),
    )
    share = renderer_of(grid, backend, options)(state, derivatives=False).share.flatten()
    found = discretisation(grid, backend, options, state, share)
    fine = ExactBackend(Cochlea(64_000), "cpu")
    fine.centre = backend.centre
    truth = Renderer(grid, fine, blur=0.4, length=0.01, fine=0.07)(state, derivatives=False).share.flatten()
    before, after = (float((s - truth).square().sum().sqrt()) for s in (share, share + found.correction))
    assert after < 0.3 * before
    # What facets and the logistic do to the volume has opposite signs.
    assert found.left.sum(1)[0] > 0 > found.left.sum(1)[1]
    assert backend.finer() is backend.finer()


def test_shapes_that_are_their_meshes_have_sample_points_alone():
    backend = ExactBackend(StatisticalShape.example(), "cpu")
    assert backend.finer() is None
    grid, options, state = sdm.Grid((-1.6,) * 3, (0.4,) * 3, (9, 9, 9)), FitOptions(blur=0.2, fine=0.2), middle(backend)
    share = renderer_of(grid, backend, options)(state, derivatives=False).share.flatten()
    found = discretisation(grid, backend, options, state, share)
    assert not found.left[0].any()
    assert found.left[1].any()


def test_covariance_of_what_is_left_is_that_of_draws():
    generator = torch.Generator().manual_seed(0)
    rows = torch.randn(2, 5, 4, 3, generator=generator, dtype=torch.float64)
    left = torch.rand(2, 60, generator=generator, dtype=torch.float64)
    spots = Discretisation(torch.zeros(60), left, (1e-3,) * 3)
    # Without a reach every voxel errs by itself.
    flat, own = rows.flatten(1), left.square().sum(0)
    expected = (flat @ left.T) @ (flat @ left.T).T + (flat * own) @ flat.T
    torch.testing.assert_close(spots.score(rows), expected)
    wide = replace(spots, reach=(1e5,) * 3).score(rows)
    torch.testing.assert_close(wide, (flat @ left.T) @ (flat @ left.T).T + torch.outer(*[flat @ own.sqrt()] * 2))


def test_states_about_different_points_are_compared_at_one(backend: ExactBackend):
    one = middle(backend).moved(torch.tensor([0.0] * 4 + [0.3, -0.2, 0.1, 1.0, 2.0, 3.0]).double())
    other = replace(one, centre=one.centre + 1, translation=one.to_world((one.centre + 1)[None])[0])
    torch.testing.assert_close(other.since(one), torch.zeros(10).double(), atol=1e-12, rtol=0)
