"""Images without a cochlea never get a confident answer."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from sdm import Grid, SDMError
from sdm.fit import ExactBackend, FitError, FitOptions, FitResult, fit_shape
from sdm.shapes import Cochlea

GRID = Grid((-7.0, -6.0, -4.0), (0.6, 0.6, 0.6), (24, 21, 14))
X, Y, Z = GRID.points().double().unbind(-1)
OPTIONS = FitOptions(starts=1, most_steps=12, fine=0.6)


def _noise(seed: int = 0) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal(GRID.shape))


def _seen(distance: Tensor) -> Tensor:
    return 1700 - 1600 * torch.sigmoid(-distance / 0.15) + 100 * _noise()


IMAGES = {
    "noise": _noise(),
    "smooth noise": torch.nn.functional.avg_pool3d(_noise()[None], 3, 1, 1)[0],
    "a ramp": 100 * X + 50 * _noise(),
    "a ball": _seen((X**2 + Y**2 + Z**2).sqrt() - 2),
    "a straight tube": _seen((Y**2 + Z**2).sqrt() - 0.8),
    "a ring": _seen(((X**2 + Y**2).sqrt() - 3).hypot(Z) - 0.7),
    "a block": _seen(torch.maximum(torch.maximum(X.abs() - 3, Y.abs() - 2), Z.abs() - 1)),
    "half of the image": _seen(Z - 0.5),
}


def _fit(image: Tensor) -> FitResult:
    return fit_shape(image, GRID, ExactBackend(Cochlea(1_000), "cpu"), options=OPTIONS)


@pytest.mark.parametrize("what", IMAGES)
def test_what_is_no_cochlea_is_not_trusted(what: str) -> None:
    result = _fit(IMAGES[what])
    # Not only because the steps did not converge: few were allowed.
    assert any("no shape of this family" in p or "not a shape of this family" in p for p in result.diagnosis.problems)
    assert not result.trusted
    with pytest.raises(FitError, match="the fit gives no answer"):
        result.require()


@pytest.mark.parametrize("voxel", [0.4, 0.5, 0.7, 0.8, 0.9, 1.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_block_is_no_cochlea_whatever_the_voxels(voxel: float, seed: int) -> None:
    grid = Grid(GRID.origin, (voxel,) * 3, [round(length / voxel) for length in (14.4, 12.6, 8.4)])
    x, y, z = (axis.abs() for axis in grid.points().double().unbind(-1))
    noise = torch.from_numpy(np.random.default_rng(seed).standard_normal(grid.shape))
    block = torch.maximum(torch.maximum(x - 3, y - 2), z - 1)
    image = 1700 - 1600 * torch.sigmoid(-block / 0.15) + 100 * noise
    result = fit_shape(image, grid, ExactBackend(Cochlea(1_000), "cpu"), options=OPTIONS)
    assert any("not a shape of this family" in problem for problem in result.diagnosis.problems)


@pytest.mark.parametrize("voxel", [0.5, 0.7, 1.0])
def test_a_cochlea_of_coarse_voxels_is_one(voxel: float) -> None:
    """Though the blur is another than the one that is named."""
    from sdm.fit import Scanner, random_state, simulate

    backend = ExactBackend(Cochlea(1_000), "cpu")
    truth = random_state(backend, 2, edge=0.1)
    image = simulate(backend, truth, Scanner(spacing=voxel, blur=0.2, noise=100.0), seed=2)
    result = fit_shape(image.values, image.grid, backend, options=FitOptions(blur=0.5))
    assert not any("not a shape of this family" in problem for problem in result.diagnosis.problems)


def test_steps_that_do_not_converge_are_said() -> None:
    from sdm.fit import Scanner, random_state, simulate

    backend = ExactBackend(Cochlea(1_000), "cpu")
    truth = random_state(backend, 3, edge=0.2)
    image = simulate(backend, truth, Scanner(spacing=0.5, blur=0.25, noise=100.0), seed=0)
    result = fit_shape(
        image.values, image.grid, backend, options=FitOptions(starts=1, most_steps=1, tolerance=1e-9, blur=0.25)
    )
    assert not result.diagnosis.converged
    assert not result.trusted
    assert "did not converge" in result.diagnosis.problems[0]


@pytest.mark.filterwarnings("ignore:var")
@pytest.mark.parametrize(("unit", "said"), [(1e-3, "not finite"), (1e3, "sampled at")])
def test_an_image_in_another_unit_is_said(unit: float, said: str) -> None:
    image = IMAGES["a ring"][::2, ::2, 3:11]
    grid = Grid([unit * x for x in GRID.origin], [unit * s for s in (1.2, 1.2, 0.6)], image.shape)
    with pytest.raises(SDMError, match=f"{said}.* unit"):
        fit_shape(image, grid, ExactBackend(Cochlea(1_000), "cpu"), options=OPTIONS)
