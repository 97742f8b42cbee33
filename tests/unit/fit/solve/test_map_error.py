"""A fit through a model's maps alone holds their error in its intervals, or is not trusted."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from sdm import Grid, SDMError
from sdm.fit import FitOptions, FitResult, GridBackend, fit_shape
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State
from sdm.shapes import Parameter
from sdm.surrogate.infer.weights_file import near_error

MAPS = Grid((-2.4, -2.4, -2.4), (0.2, 0.2, 0.2), (25, 25, 25))
IMAGE = Grid((-2.1, -2.1, -2.1), (0.3, 0.3, 0.3), (15, 15, 15))
PARAMETERS = (Parameter("r", 0.5, 2.0, "mm"),)
RADIUS, OFF = 1.2, 0.03
OPTIONS = FitOptions(starts=1)


def ball(theta: Tensor) -> Tensor:
    """Distances to balls of radius theta[:, 0] about the origin."""
    return (MAPS.points().norm(dim=-1) - theta[:, 0, None, None, None])[:, None]


def too_small(theta: Tensor) -> Tensor:
    """The same, `OFF` too far everywhere, so that a fit finds the radius too large."""
    return ball(theta) + OFF


@pytest.fixture(scope="module")
def image() -> Tensor:
    noise = torch.randn(IMAGE.shape, generator=torch.Generator().manual_seed(3))
    none = torch.zeros(3, dtype=torch.float64)
    state = State(torch.tensor([RADIUS], dtype=torch.float64), torch.eye(3, dtype=torch.float64), none, none)
    renderer = Renderer(IMAGE, GridBackend(ball, MAPS, PARAMETERS), blur=0.2, length=0.025, fine=0.15)
    return 1000 * renderer(state, derivatives=False).share + 5 * noise


def fitted(image: Tensor, error: float | None, exact: GridBackend | None = None) -> FitResult:
    backend = GridBackend(too_small, MAPS, PARAMETERS, error=error, exact=exact)
    return fit_shape(image, IMAGE, backend, options=OPTIONS)


@pytest.fixture(scope="module")
def plain(image: Tensor) -> FitResult:
    return fitted(image, 0.0)


def test_error_that_nobody_says_is_not_trusted(image: Tensor, plain: FitResult, tmp_path: Path) -> None:
    found = fitted(image, None)
    assert not found.trusted
    assert torch.equal(found.state.theta, plain.state.theta)
    found.save(tmp_path / "fit.json")
    record = json.loads((tmp_path / "fit.json").read_text())
    assert not record["trusted"]
    assert "nobody says how far the maps of surrogate are off" in record["problems"][0]


def test_known_error_is_in_the_intervals(image: Tensor, plain: FitResult) -> None:
    # Without it the interval is far from the truth, and thinks well of itself.
    assert plain.trusted
    assert float(plain.state.theta) - RADIUS == pytest.approx(OFF, abs=0.01)
    assert float(plain.posterior.intervals(0.9)[0, 0]) > RADIUS
    found = fitted(image, OFF)
    assert found.trusted
    low, high = found.posterior.intervals(0.9)[0].tolist()
    assert low < RADIUS < high
    assert f"surrogate are {OFF:g} mm off near the surface" in " ".join(found.diagnosis.warnings)
    # The patches are the octants of the ball: eight independent errors, an eighth of the surface each, and all of it.
    beyond = math.sqrt(float(found.posterior.deviations[0] ** 2 - plain.posterior.deviations[0] ** 2))
    assert beyond == pytest.approx(OFF * math.sqrt(1 / 8 + 1), rel=0.05)


def test_anchored_fit_needs_no_error(image: Tensor) -> None:
    found = fitted(image, None, exact=GridBackend(ball, MAPS, PARAMETERS))
    assert found.trusted
    assert float(found.state.theta) == pytest.approx(RADIUS, abs=0.01)
    assert not [text for text in found.diagnosis.warnings if "off near the surface" in text]


def test_an_error_is_a_length() -> None:
    for error in (-0.1, math.inf, math.nan):
        with pytest.raises(SDMError, match="root mean square"):
            GridBackend(ball, MAPS, PARAMETERS, error=error)


def test_records_and_cards_say_an_error() -> None:
    assert near_error({"errors": {"mae_near_mm": 0.04}}) == pytest.approx(0.04 * math.sqrt(math.pi / 2))
    assert near_error({"near": 0.02, "mean": 0.1}) == pytest.approx(0.02 * math.sqrt(math.pi / 2))
    assert near_error({"training": {}}) is None
