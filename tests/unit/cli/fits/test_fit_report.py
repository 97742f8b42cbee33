"""Files of a fit: the surface is made where one of them needs it, once."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from sdm.cli.fits import fit_report
from sdm.core.mesh import TriangleMesh
from sdm.fit.solve import free_form


def fit() -> Any:
    """A fit of no parameters that is trusted."""
    return SimpleNamespace(
        require=lambda: None, record=lambda: {"trusted": True}, diagnosis=SimpleNamespace(hopeless=False), blur=None
    )


@pytest.mark.parametrize(("names", "made"), [((), 0), (("mesh",), 1), (("mesh", "free_form"), 1)])
def test_the_surface_is_made_where_a_file_needs_it(tmp_path: Path, monkeypatch, names, made) -> None:
    mesh = TriangleMesh(torch.eye(3), torch.tensor([[0, 1, 2]], dtype=torch.int32))
    calls = []
    monkeypatch.setattr(fit_report, "print_fit", lambda *given: None)
    monkeypatch.setattr(free_form, "free_form", lambda *given, **more: SimpleNamespace(mesh=given[2], moved=0.0))
    files = fit_report.FitFiles(tmp_path / "fit.json", **{name: tmp_path / f"{name}.ply" for name in names})
    scan, backend = SimpleNamespace(values=None, grid=None), SimpleNamespace(device="cpu")
    fit_report.write_fit(files, scan, backend, fit(), blur=0.2, surface=lambda: calls.append(1) or mesh)  # pyright: ignore[reportArgumentType]
    assert len(calls) == made
    assert sorted(path.stem for path in tmp_path.iterdir()) == sorted(["fit", *names])
    assert json.loads(files.report.read_text()) == {"trusted": True}
