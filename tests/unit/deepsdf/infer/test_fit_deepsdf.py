"""Fits of a DeepSDF to images and points: the whole code holds what its components do not, and no size drifts."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator

import numpy as np
import pytest
import torch

import sdm
from sdm.cli import main
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.deepsdf import DeepSDF
from sdm.deepsdf.infer import fit_backend
from sdm.deepsdf.infer.fit_backend import DeepSDFBackend
from sdm.deepsdf.infer.fit_code import _Image, fit_code, surface_of_code
from sdm.deepsdf.infer.fit_deepsdf import fit_deepsdf, fit_deepsdf_points
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State, rotation_from_vector
from sdm.fit.solve.fit_shape import FitOptions
from sdm.runtime.threads import threads
from sdm.viz.fit_figure import surface_at
from tests.helpers.star_shapes import MEAN, NUMBERS, blobs

VOXEL, BLUR, SIZE = 0.8, 0.4, 5.1


@pytest.fixture(scope="module")
def model() -> DeepSDF:
    return blobs()


@pytest.fixture(autouse=True)
def three(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Three components, which leave a third of a shape open; one thread, which is quicker for so little."""
    monkeypatch.setattr(fit_backend, "MOST", 3)
    with threads(1):
        yield


class Truth:
    """A shape that is none of the training's: turned, shifted, with bumps that its components do not have."""

    def __init__(self, model: DeepSDF) -> None:
        code = MEAN + torch.tensor([0.1, -0.06, 0.05] + [0.08, -0.07] * 4 + [0.09])
        turn = rotation_from_vector(torch.tensor([0.1, -0.15, 0.1], dtype=torch.float64))
        place = torch.tensor([0.4, -0.3, 0.2], dtype=torch.float64)
        size = torch.tensor([SIZE], dtype=torch.float64)
        self.state = State(size, turn, place, torch.zeros(3, dtype=torch.float64))
        self.backend = DeepSDFBackend(model)
        self.mesh = surface_of_code(self.backend, code, self.state, 48)
        # As a backend without parameters, which is rendered.
        self.model, self.code = model, code
        self.device, self.centre, self.slack = model.device, self.state.centre, 0.1

    def distances(self, theta: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
        return SIZE * self.model.signed_distance((points / SIZE).float(), self.code).double()

    def image(self, noise: float) -> sdm.SDM:
        grid = Grid((-6.8, -6.8, -6.8), (VOXEL,) * 3, (18, 18, 18))
        share = Renderer(grid, self, blur=BLUR, length=0.05, fine=0.4)(self.state, derivatives=False).share  # type: ignore[arg-type]
        white = torch.randn(grid.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
        return sdm.SDM((1000 * share + noise * white).float(), grid)

    def off(self, mesh: TriangleMesh) -> float:
        ways = ((mesh, self.mesh), (self.mesh, mesh))
        return sum(float(sdm.MeshIndex(b, "cpu").signed_distance(a.vertices).abs().mean()) for a, b in ways) / 2


@pytest.mark.parametrize("noise", [0, 50])
def test_an_image_is_held_by_the_whole_code(noise: float, model: DeepSDF) -> None:
    truth, scan = Truth(model), Truth(model).image(noise)
    fit = fit_deepsdf(scan.values, scan.grid, model, options=FitOptions(blur=BLUR, fine=0.4, length=0.05, starts=1))
    assert fit.code is not None
    alone = truth.off(surface_at(truth.backend, fit.result.state))
    whole = truth.off(fit.code.mesh(truth.backend, 48))
    assert whole < 0.07 * VOXEL
    assert whole < 0.7 * alone
    assert fit.result.trusted
    assert fit.result.diagnosis.explained > 0.99
    # Intervals are of components that hold less, which does not show in noise.
    assert any("components" in warning for warning in fit.result.diagnosis.warnings) == (noise == 0)
    # Held where the components found it: codes hold sizes of their own.
    assert float(fit.code.state.theta[0]) == pytest.approx(float(fit.result.state.theta[0]), rel=0.05)
    assert fit.code.converged
    # The network is not exact.
    assert fit.code.noise == pytest.approx(noise, rel=0.05, abs=20)
    assert fit.code.outside == pytest.approx(0, abs=20)


def test_points_are_held_by_the_whole_code(model: DeepSDF) -> None:
    truth = Truth(model)
    random = torch.Generator().manual_seed(4)
    chosen = torch.randperm(len(truth.mesh.vertices), generator=random)[:800]
    points = truth.mesh.vertices[chosen].double() + 0.05 * torch.randn(800, 3, generator=random, dtype=torch.float64)
    fit = fit_deepsdf_points(points, model)
    alone = truth.off(surface_at(truth.backend, fit.components.posterior.state))
    whole = truth.off(surface_of_code(truth.backend, fit.code.code, fit.code.state, 48))
    assert fit.code.converged
    assert whole < 0.03
    assert whole < 0.5 * alone
    assert fit.code.noise == pytest.approx(0.05, rel=0.15)
    assert abs(float(fit.code.state.theta[0]) / SIZE - 1) < 0.08
    assert 7 < fit.code.determined < NUMBERS + 8


def test_the_command_takes_points(
    model: DeepSDF, tmp_path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(DeepSDF, "load", classmethod(lambda cls, name, device=None: model))
    monkeypatch.chdir(tmp_path)
    truth = Truth(model)
    np.save("points.npy", truth.mesh.vertices[::10].numpy())
    words = ["fit", "--points", "points.npy", "-o", "fit.json", "--family", "m.pt", "--device", "cpu"]
    assert main([*words, "--mesh", "fit.ply"]) == 0
    said = capsys.readouterr().out
    assert f"all {NUMBERS} numbers" in said
    assert truth.off(sdm.load_mesh("fit.ply")) < 0.03
    record = json.loads((tmp_path / "fit.json").read_text())
    assert record["code"]["numbers"] == NUMBERS
    assert record["code"]["converged"]
    assert "code3" in record["theta"]
    for more in (["--triangles", "500"], ["--mirror"]):
        assert main([*words, *more]) == 2
        assert "--mirror" in capsys.readouterr().err


def test_noise_is_no_shape_of_a_deepsdf(model: DeepSDF) -> None:
    noise = torch.randn(20, 20, 20, generator=torch.Generator().manual_seed(0))
    fit = fit_deepsdf(noise, Grid((-5, -5, -5), (VOXEL,) * 3, (20, 20, 20)), model)
    assert fit.code is None
    assert not fit.result.trusted


@pytest.mark.parametrize("bump", [0.0, 0.3])
def test_a_search_that_cannot_go_down_has_converged_only_where_it_would_not_go_far(
    bump: float, model: DeepSDF, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = Truth(model)
    scan, options = truth.image(0), FitOptions(blur=BLUR, fine=0.4, length=0.05)
    rising = itertools.count()
    monkeypatch.setattr(_Image, "objective", lambda *given: float(next(rising)))
    # Components of the training's codes; where they begin is the truth but for these.
    theta = torch.cat([truth.state.theta, torch.zeros(3, dtype=torch.float64)])
    code = truth.code + bump * torch.eye(NUMBERS)[3]
    monkeypatch.setattr(DeepSDFBackend, "code", lambda *given: code)
    start = State(theta, truth.state.rotation, truth.state.translation, truth.state.centre)
    fit = fit_code(scan.values, scan.grid, truth.backend, start, options=options, explained=1.0)
    assert fit.steps == 0
    assert fit.converged == (bump == 0)
    # A shape that is wrong leaves more than the noise where it cuts voxels.
    assert (fit.noise > 30) == (bump > 0)
