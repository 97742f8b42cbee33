"""`sdm watertight`: one mesh, folders with bad meshes, reports, and what is refused."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

import sdm
from sdm.cli import main
from sdm.cli.surfaces import closing, closing_job, closing_stages, journal
from sdm.core.mesh import TriangleMesh
from tests.helpers.closed_surface import assert_edges_cancel
from tests.helpers.processes.killed_command import killed_after


@pytest.fixture(autouse=True)
def few_samples(monkeypatch):
    """For distances of two surfaces, which take nearly all of the time otherwise."""
    monkeypatch.setattr(sys.modules["sdm.remeshing.watertight"], "SAMPLES", 1000)


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


def test_surfaces_in_the_folder_that_is_read_are_no_meshes_to_close(roof, capsys, monkeypatch):
    """The same command once more has the same meshes, also by another way to the folder."""
    monkeypatch.chdir(roof.parent.parent)
    words = ["watertight", "in", "--resolution", "8", "--device", "cpu", "-o"]
    assert main([*words, "in/closed"]) == 0
    assert main([*words, "in/closed", "--resume"]) == 0
    assert main([*words, str(roof.parent / "closed"), "--resume"]) == 0
    assert "is there already" in capsys.readouterr().out
    assert sorted(path.name for path in (roof.parent / "closed").iterdir()) == ["report.json", "roof.ply"]


def test_a_run_that_was_interrupted_goes_on(roof, tmp_path, capsys, monkeypatch):
    """Finished surfaces are left; those of another mesh, in another way, or cut short are made again."""
    for number in range(3):
        (roof.parent / f"roof{number}.obj").write_bytes(roof.read_bytes())
    out, made = tmp_path / "out", []
    words = ["watertight", str(roof.parent), "-o", str(out), "--resolution", "16", "--device", "cpu"]
    close = closing_stages.watertight

    def interrupted(mesh, *args, **options):
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(mesh.name)
        return close(mesh, *args, **options)

    monkeypatch.setattr(closing_job, "threads_beside", lambda _: 1)
    monkeypatch.setattr(closing_stages, "watertight", interrupted)
    assert main(words) == 130
    monkeypatch.setattr(closing_stages, "watertight", close)
    assert not (out / "report.json").exists()
    lines = (out / journal.NAME).read_text().strip().splitlines()
    # One more was written than was told when the interrupt came, or none.
    assert len(lines) in (1, 2)
    (out / journal.NAME).write_text("\n".join([*lines, lines[0][: len(lines[0]) // 2]]))
    capsys.readouterr()
    assert main([*words, "--resume"]) == 0
    assert capsys.readouterr().out.count("is there already") == len(lines)
    report = json.loads((out / "report.json").read_text())
    assert [entry["state"] for entry in report["meshes"]].count("there already") == len(lines)
    assert len(report["surfaces"]) == 4
    assert sorted(path.name for path in out.iterdir()) == ["report.json", *(f"roof{n}.ply" for n in ("", 0, 1, 2))]
    # From the report.
    first = out / "roof.ply"
    whole = first.read_bytes()
    first.write_bytes(whole[:-1])
    other = sdm.load_mesh(roof.parent / "roof0.obj")
    sdm.save_mesh(TriangleMesh(other.vertices + 1, other.faces), roof.parent / "roof0.obj")
    assert main([*words, "--resume"]) == 0
    assert capsys.readouterr().out.count("is there already") == 2
    assert first.read_bytes() == whole
    assert main([*words, "--resume", "--hidden", "keep"]) == 0
    assert "is there already" not in capsys.readouterr().out


def test_workers_share_the_meshes(roof, tmp_path, capsys, monkeypatch):
    """The same surfaces, lines and report as by one, and a restart that leaves what is there."""
    for number in range(9):
        (roof.parent / f"roof{number}.obj").write_bytes(roof.read_bytes())
    (roof.parent / "bad.stl").write_text("nothing")
    words = ["watertight", str(roof.parent), "--resolution", "16", "--device", "cpu", "--skip-bad", "-o"]
    assert main([*words, str(tmp_path / "one")]) == 0
    alone, shared = capsys.readouterr().out, []

    def by_turns(job, shards, devices, done, **_):
        shared.append(len(shards))
        makers = [job.maker(device) for device in devices]
        # As processes would that end in another order.
        for place in (1, 0):
            job.run(shards[place::2], makers[place], done)

    monkeypatch.setattr(closing, "processes_for", lambda devices, *_, **__: devices * 2)
    monkeypatch.setattr("sdm.runtime.sharing.share_out.run_here", by_turns)
    assert main([*words, str(tmp_path / "two")]) == 0
    told = capsys.readouterr().out
    lines = [[line.partition(" voxels")[0] for line in text.splitlines()] for text in (alone, told)]
    assert lines[0] == lines[1]
    assert shared == [3]
    found = [{file.name: file.read_bytes() for file in (tmp_path / name).glob("*.ply")} for name in ("one", "two")]
    assert found[0] == found[1]
    assert len(found[0]) == 10
    reports = [json.loads((tmp_path / name / "report.json").read_text()) for name in ("one", "two")]
    assert reports[0]["surfaces"].keys() == reports[1]["surfaces"].keys()
    assert [entry["state"] for entry in reports[1]["meshes"]].count("done") == 10
    (tmp_path / "two" / "roof3.ply").unlink()
    assert main([*words, str(tmp_path / "two"), "--resume"]) == 0
    assert capsys.readouterr().out.count("is there already") == 9
    assert (tmp_path / "two" / "roof3.ply").exists()


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


@pytest.mark.slow
def test_kill_9_leaves_no_broken_surface_and_is_resumed_to_the_same_bytes(roof, tmp_path):
    for number in range(12):
        (roof.parent / f"roof{number}.obj").write_bytes(roof.read_bytes())
    out, whole = tmp_path / "out", tmp_path / "whole.ply"
    words = ["watertight", str(roof.parent), "-o", str(out), "--resolution", "16", "--device", "cpu"]
    killed_after(words, out, "[a-z]*.ply")
    assert main(["watertight", str(roof), "-o", str(whole), "--resolution", "16", "--device", "cpu"]) == 0
    there = sorted(out.glob("[a-z]*.ply"))
    assert all(path.read_bytes() == whole.read_bytes() for path in there)
    before = {path: path.stat().st_mtime_ns for path in there}
    assert main([*words, "--resume"]) == 0
    found = list(out.glob("[a-z]*.ply"))
    assert len(found) == 13
    assert all(path.read_bytes() == whole.read_bytes() for path in found)
    # At most what was in flight is made again: written, and not yet in the journal.
    kept = [path for path, when in before.items() if path.stat().st_mtime_ns == when]
    assert len(before) - len(kept) <= 3
