"""`sdm watertight`: one mesh, folders with bad meshes, reports, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

import sdm
from sdm.cli import main
from sdm.core.mesh import TriangleMesh
from tests.helpers.closed_surface import assert_edges_cancel


@pytest.fixture
def roof(tmp_path):
    """A file with two sheets that meet at an edge."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0.5, 0.8], [1, 0.5, 0.8]])
    faces = np.array([[0, 1, 5], [0, 5, 4], [3, 4, 5], [3, 5, 2]])
    path = tmp_path / "in" / "roof.obj"
    path.parent.mkdir()
    sdm.save_mesh(TriangleMesh(vertices, faces), path)
    return path


@pytest.mark.parametrize("ending", ["ply", "off"])
def test_one_mesh_gives_one_closed_file(roof, tmp_path, capsys, ending):
    out = tmp_path / f"closed.{ending}"
    assert main(["watertight", str(roof), "-o", str(out), "--resolution", "24"]) == 0
    surface = sdm.load_mesh(out)
    assert_edges_cancel(surface.numpy()[1], len(surface.vertices))
    said = capsys.readouterr().out
    assert "roof.obj: 4 triangles, not closed" in said
    assert "mesh to surface at most" in said


def test_a_folder_goes_on_past_a_bad_mesh(roof, tmp_path, capsys):
    (roof.parent / "bad.stl").write_text("nothing")
    out = tmp_path / "out"
    words = ["watertight", str(roof.parent), "-o", str(out), "--resolution", "16", "--format", "stl"]
    assert main(words) == 2
    assert "1 of 2 meshes failed" in capsys.readouterr().err
    assert sorted(path.name for path in out.iterdir()) == ["report.json", "roof.stl"]
    report = json.loads((out / "report.json").read_text())
    assert [entry["state"] for entry in report["meshes"]] == ["failed", "done"]
    (surface,) = report["surfaces"].values()
    assert 0 < surface["output_to_input"]["largest"] < surface["spacing"]
    assert main([*words, "--skip-bad"]) == 0


def test_what_cannot_be_is_refused_in_a_sentence(roof, tmp_path, capsys):
    cases = {
        "does not end like a mesh": [str(roof), "-o", str(tmp_path / "a.nii.gz")],
        "several meshes need a folder": [str(roof.parent), "-o", str(tmp_path / "a.ply")],
        "is an input too": [str(roof), "-o", str(roof)],
        "which --format asks for": [str(roof), "-o", str(tmp_path / "a.ply"), "--format", "stl"],
        "too low": [str(roof), "-o", str(tmp_path / "a.ply"), "--resolution", "2"],
        "no mesh was found": [str(tmp_path / "none"), "-o", str(tmp_path / "b")],
    }
    (tmp_path / "none").mkdir()
    for sentence, words in cases.items():
        assert main(["watertight", *words]) == 2
        assert sentence in capsys.readouterr().err
    assert not (tmp_path / "a.ply").exists()
