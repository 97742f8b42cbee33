from __future__ import annotations

import json

import pytest
import trimesh

from sdm.cli import main


@pytest.fixture
def inside_out(tmp_path):
    box = trimesh.creation.box()
    box.invert()
    box.export(tmp_path / "box.stl")
    return tmp_path / "box.stl"


def test_the_table(inside_out, capsys):
    assert main(["inspect", str(inside_out)]) == 0
    said = capsys.readouterr()
    for words in ("box.stl", "triangles", "12", "-0.5 -0.5 -0.5  to  0.5 0.5 0.5", "inside out", "--orient auto"):
        assert words in said.out
    assert said.err == ""
    (outward,) = (line for line in said.out.splitlines() if line.startswith("faces outward"))
    assert outward.split()[-1] == "no"


def test_problems_are_one_line_each_through_a_pipe(inside_out, capsys):
    main(["inspect", str(inside_out)])
    lines = capsys.readouterr().out.splitlines()
    (problem,) = (line for line in lines if line.startswith("- "))
    assert problem.endswith("turns it")


def test_json(inside_out, capsys):
    assert main(["inspect", "--json", str(inside_out)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["closed"], found["outward"], found["triangles"]) == (True, False, 12)
    assert len(found["problems"]) == 1


def test_a_clean_mesh(tmp_path, capsys):
    trimesh.creation.icosphere(1).export(tmp_path / "ball.off")
    assert main(["inspect", str(tmp_path / "ball.off")]) == 0
    assert "no problems found" in capsys.readouterr().out


def test_a_name_that_looks_like_markup(tmp_path, capsys):
    trimesh.creation.box().export(tmp_path / "[red]box.off")
    assert main(["inspect", str(tmp_path / "[red]box.off")]) == 0
    assert "[red]box.off" in capsys.readouterr().out
