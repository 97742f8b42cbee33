"""The study of shape models goes on from what was laid, and writes the model."""

from __future__ import annotations

import json
from functools import partial

import pytest
import torch

from sdm.bench.deepsdf.shapes import Shapes
from sdm.bench.shapes import atria
from sdm.core.mesh import TriangleMesh
from sdm.shapes import Ellipsoid, load_family
from sdm.shapes.models import lay_template
from sdm.shapes.models.lay_template import TemplateLayer


@pytest.fixture
def shapes(monkeypatch):
    family = Ellipsoid()
    theta = family.sample(4, seed=1, device="cpu")
    meshes = [TriangleMesh(v, family.faces, f"e{n}", check=False) for n, v in enumerate(family.vertices(theta))]
    monkeypatch.setattr(atria, "atria", lambda source, cache: Shapes(meshes, []))
    monkeypatch.setattr(atria, "TemplateLayer", partial(TemplateLayer, turns=1))
    monkeypatch.setattr(lay_template, "SAMPLES", 200)
    monkeypatch.setattr(atria, "read_record", lambda: {"names": [], "distances_mm": []})


def test_it_goes_on_from_what_is_laid(shapes, tmp_path, capsys):
    words = ["--laid", str(tmp_path / "laid.pt"), "--model", str(tmp_path / "m.npz"), "--modes", "2", "--device", "cpu"]
    words += ["--triangles", "200", "--parts", "model", "--out", str(tmp_path / "r.json")]
    atria.main(words)
    first = json.loads((tmp_path / "r.json").read_text())
    kept = torch.load(tmp_path / "laid.pt", weights_only=True)
    for part in ("rows", "points"):
        del kept[part]["e3"]
    torch.save(kept, tmp_path / "laid.pt")
    capsys.readouterr()
    atria.main(words)
    said = capsys.readouterr().out
    assert said.count("of 4") == 1
    assert "'name': 'e3'" in said
    again = json.loads((tmp_path / "r.json").read_text())
    assert [row["distance"] for row in again["registration"]] == [row["distance"] for row in first["registration"]]
    assert len(load_family(str(tmp_path / "m.npz")).parameters) == 2
    assert torch.load(tmp_path / "laid.pt", weights_only=True)["points"].keys() == {f"e{n}" for n in range(4)}
    with pytest.raises(SystemExit, match="another template"):
        atria.main([*words, "--triangles", "300"])
