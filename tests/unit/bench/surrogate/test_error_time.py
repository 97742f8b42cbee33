"""Error against time: a row for each method, fewer modes of one decomposition, and a picture."""

from __future__ import annotations

import torch

from sdm.bench.surrogate import error_time
from sdm.bench.surrogate.error_time_figure import draw
from sdm.shapes import Cochlea
from sdm.surrogate import GRID, PODChebyshev


def test_rows_have_times_and_errors_and_can_be_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(error_time, "Cochlea", lambda: Cochlea(500))
    exact = error_time.exact(Cochlea(500))
    found = {
        ("exact engine", "500 triangles"): exact,
        ("SDMNN+", "torch"): lambda theta: exact(theta) + 0.01,
        ("SDMNN+", "other"): lambda theta: exact(theta) - 0.02,
    }
    rows = error_time.measured(found, Cochlea().sample(1, device="cpu"), rounds=2)
    assert [round(row["mae_near_mm"], 4) for row in rows] == [0.0, 0.01, 0.02]
    assert all(row["ms"] >= row["least_ms"] > 0 for row in rows)
    draw({"rows": rows, "shapes": 1, "machine": {"device": "a CPU"}}, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 1000


def test_the_coarsest_mesh_that_is_no_worse(monkeypatch):
    monkeypatch.setattr(error_time, "REFERENCE", 2000)
    theta = Cochlea().sample(1, device="cpu")
    equal = error_time.coarsest(error_time.exact(Cochlea(1250)), theta)
    assert set(equal) == set(error_time.ERRORS)
    assert all(1000 < triangles <= 1250 for triangles in equal.values())
    rows = [
        {"method": "SDMNN+", "of": "torch", "ms": 2.0},
        {"method": "libigl winding number", "of": "1,250 triangles", "ms": 300.0},
        {"method": "libigl pseudonormal", "of": "1,250 triangles", "ms": 201.0},
    ]
    found = error_time.times_libigl(rows, {"mae_mm": 1250})
    assert found == {"mae_mm": {"triangles": 1250, "times": 100.5}}


def test_fewer_modes_of_a_decomposition():
    whole = PODChebyshev(3, 1)
    whole.weights, whole.modes = torch.randn(5, 3), torch.randn(3, GRID.size)
    theta = Cochlea().sample(1, device="cpu")
    wanted = (whole.terms(theta) @ whole.weights[:, :2]) @ whole.modes[:2]
    torch.testing.assert_close(error_time.first_modes(whole, 2)(theta).detach().flatten(1), wanted)
