"""Names of files may hold new lines and what terminals take for commands: each line that is printed stays one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import trimesh

from sdm.cli import main
from sdm.cli.common.printed_line import printable

SMALL = ["--resolution", "8", "--device", "cpu"]
BALL, HOLED, BAD = "a\nb.ply", "c\x1b[31md.ply", "e\r\nf.stl"


@pytest.fixture
def meshes(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "in\tput"
    folder.mkdir()
    ball = trimesh.creation.icosphere(1)
    (folder / BALL).write_bytes(bytes(ball.export(file_type="ply")))
    ball.update_faces(ball.faces[:, 0] > 0)
    (folder / HOLED).write_bytes(bytes(ball.export(file_type="ply")))
    (folder / BAD).write_text("nothing")
    return folder


def lines(capsys) -> list[str]:
    said, errors = capsys.readouterr()
    found = [*said.removesuffix("\n").split("\n"), *errors.removesuffix("\n").split("\n")]
    assert not [line for line in found if any(ord(letter) < 32 for letter in line)]
    return [line for line in found if line]


def test_escapes_are_those_of_python():
    assert printable("é\n\x1b\x7f\x85\u2028\t\\") == "é\\n\\x1b\\x7f\\x85\\u2028\\t\\"


def test_a_folder_is_told_of_in_a_line_for_each_mesh(meshes, capsys):
    assert main(["compute", str(meshes), "-o", "maps", "--format", "npz", *SMALL]) == 2
    done, holed, warning, failed, _ = lines(capsys)
    assert done.startswith("a\\nb.ply: 80 triangles")
    assert done.endswith("written to maps/a\\nb.npz")
    assert holed.startswith("c\\x1b[31md.ply: ")
    assert warning.startswith("sdm: warning: c\\x1b[31md.ply is not closed")
    # The file is named once.
    assert failed.startswith(f"sdm: {meshes.parent}/in\\tput/e\\r\\nf.stl cannot be read")
    assert main(["watertight", str(meshes), "-o", "closed", *SMALL, "--skip-bad"]) == 0
    assert len(lines(capsys)) == 4
    # Names in records are what they are.
    told = json.loads((meshes.parent / "closed" / "report.json").read_text())
    assert told["meshes"][0]["mesh"].endswith(BALL)
    assert main(["generate", str(meshes), "-o", "d\n.zarr", "--count", "1", *SMALL, "--skip-bad"]) == 0
    assert len(lines(capsys)) == 3


def test_one_mesh_and_errors(meshes, capsys):
    assert main(["inspect", str(meshes / BALL)]) == 0
    assert lines(capsys)[0].strip() == "a\\nb.ply"
    assert main(["inspect", str(meshes / BALL), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["name"] == BALL
    assert main(["compute", "no\nfile.stl", "-o", "m.npz", *SMALL]) == 2
    assert lines(capsys) == ["sdm: there is no mesh file no\\nfile.stl"]
    assert main(["edt", "no\nfile.nii", "-o", "m.npz"]) == 2
    assert len(lines(capsys)) == 1
    assert main(["ed\nt"]) == 2
    assert len(lines(capsys)) == 1
