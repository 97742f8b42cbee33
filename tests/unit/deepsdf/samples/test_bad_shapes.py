"""Bad meshes of a set are left out, and said, where that is asked for."""

from __future__ import annotations

import pytest
import trimesh

from sdm import MeshError, TriangleMesh
from sdm.cli import main
from sdm.deepsdf.samples import ShapeSet


def test_a_set_goes_on_without_them():
    ball = trimesh.creation.icosphere(1)
    good = TriangleMesh(ball.vertices, ball.faces, "good")
    opened = TriangleMesh(ball.vertices, ball.faces[1:], "open")
    point = TriangleMesh([[1.0, 2, 3]], [[0, 0, 0]], "point")
    found = ShapeSet([opened, good, point], "cpu", skip_bad=True)
    assert found.names == ("good",)
    assert [name for name, _ in found.rejected] == ["open", "point"]
    assert "not closed (3 edges" in found.rejected[0][1]
    with pytest.raises(MeshError, match="open is not closed"):
        ShapeSet([good, opened], "cpu")
    with pytest.raises(MeshError, match="none of 2 meshes"):
        ShapeSet([opened, point], "cpu", skip_bad=True)


def test_a_training_too(tmp_path, capsys):
    folder = tmp_path / "shapes"
    for name in ("a/1", "a/2", "b/1"):
        (folder / name).mkdir(parents=True)
        trimesh.creation.icosphere(1).export(folder / name / "model.ply")
    ball = trimesh.creation.icosphere(1)
    trimesh.Trimesh(ball.vertices, ball.faces[1:], process=False).export(folder / "open.ply")
    (folder / "bad.off").write_text("OFF\nthree\n")
    words = ["train", "deepsdf", str(folder), "-o", str(tmp_path / "out"), "--epochs", "1", "--points", "16"]
    words += ["--width", "8", "--batch-size", "2", "--device", "cpu"]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert "bad.off" in said
    assert "--skip-bad goes on without it" in said
    (folder / "bad.off").unlink()
    assert main(words) == 2
    assert "skip_bad=True (--skip-bad) goes on without it" in capsys.readouterr().err
    (folder / "bad.off").write_text("OFF\nthree\n")
    assert main([*words, "--skip-bad"]) == 0
    said = capsys.readouterr()
    assert "open.ply is not used: it is not closed" in said.err
    assert "bad.off is not used" in said.err
    assert "3 shapes" in said.out
