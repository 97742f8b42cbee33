"""Folders of foreign meshes: every file is measured or refused, what goes wrong is seen, and slices make a whole."""

from __future__ import annotations

import json
import tarfile

import numpy as np
import pytest

from sdm.bench.common.dirty_meshes.by_code import half_spheres
from sdm.bench.common.meshes import load_case
from sdm.bench.zoo import __main__ as zoo
from sdm.bench.zoo import pack, speed
from sdm.bench.zoo.folder import Found, meshes_of
from sdm.bench.zoo.speed_summary import lines, summaries
from sdm.bench.zoo.trial import trial
from sdm.bench.zoo.worker import Worker
from sdm.cli import main as sdm_command
from tests.helpers.misbehave import misbehave


@pytest.fixture
def folder(tmp_path):
    """A torus, open bowls in a folder below, a small mesh, an empty file, and one that is no mesh's."""
    place = tmp_path / "meshes"
    (place / "below").mkdir(parents=True)
    torus, box = load_case("torus-500"), load_case("cube")
    meshes = {"torus": (torus.vertices, torus.faces), "below/bowls": half_spheres(2), "cube": (box.vertices, box.faces)}
    for name, (vertices, faces) in meshes.items():
        np.savez(place / f"{name}.npz", vertices=vertices, faces=faces)
    (place / "empty.off").touch()
    (place / "picture.png").write_bytes(b"x")
    return place


def test_a_mesh_is_measured_right(folder):
    row = trial(Found(folder / "below" / "bowls.npz", "below/bowls"), "cpu", 16, 40)
    assert not zoo.is_wrong(row)
    assert row["checked"]["points"] == 80
    assert not row["closed"]
    assert row["components"] == 2
    assert min(row["first_ms"], row["repeated_ms"], row["stock_ms"]) > 0


def test_wrong_values_are_seen(folder, monkeypatch):
    class Off:
        def __init__(self, *_):
            pass

        def distance(self, at):
            return (np.full(len(at), 0.123),)

        def winding_number(self, at):
            return np.zeros(len(at))

    monkeypatch.setattr("sdm.bench.zoo.trial.Brute", Off)
    row = trial(Found(folder / "torus.npz", "torus"), "cpu", 16, 40)
    assert zoo.is_wrong(row)
    assert "WRONG" in zoo.sentence(row)


def test_exceptions_and_sentences_are_told_apart(folder, monkeypatch):
    assert "is empty" in trial(Found(folder / "empty.off", "empty.off"), "cpu", 16, 10)["refused"]
    (folder / "bad.npz").write_bytes(b"PK")
    assert "refused" in trial(Found(folder / "bad.npz", "bad"), "cpu", 16, 10)
    monkeypatch.setattr("sdm.bench.zoo.trial._look", lambda mesh: {}["no"])
    row = trial(Found(folder / "torus.npz", "torus"), "cpu", 16, 10)
    assert row["broken"] == "KeyError: 'no'"
    assert zoo.summary([row])["broken"] == 1


def test_a_worker_outlives_hangs_and_crashes():
    worker = Worker(misbehave, 300.0)
    assert worker("well") == {"how": "well"}
    assert worker("die") == "the process ended with code 3"
    worker._limit_s = 0.2
    assert worker("hang") == "took more than 0.2 s"
    worker.close()


def test_command_writes_a_row_for_each_file(folder, tmp_path, monkeypatch, capsys):
    class Here(Worker):
        def __call__(self, *inputs):
            return self._function(*inputs)

    monkeypatch.setattr(zoo, "Worker", Here)
    out = tmp_path / "out" / "zoo.json"
    words = ["bench", "zoo", str(folder), "--device", "cpu", "--resolution", "12", "--points", "20", "--out", str(out)]
    assert sdm_command(words) == 0
    report = json.loads(out.read_text())
    assert [row["mesh"] for row in report["rows"]] == ["below/bowls", "cube", "empty.off", "torus"]
    assert report["summary"]["refused"] == 1
    assert report["endings_not_read"] == {".png": 1}
    assert str(folder) not in out.read_text()
    table = out.with_suffix(".md").read_text()
    assert "| below/bowls | " in table
    assert "- empty.off is empty" in table
    assert "empty.off refused: empty.off is empty" in capsys.readouterr().out
    assert sdm_command(["bench", "zoo", str(folder / "nowhere")]) == 2


def test_packed_meshes_are_the_folder_again(folder, tmp_path):
    archive = tmp_path / "small.tar.xz"
    assert pack.main([str(folder), str(archive)]) == 0
    with tarfile.open(archive) as packed:
        packed.extractall(tmp_path / "again", filter="data")
    before, after = (list(meshes_of(place, speed.LEAST)) for place in (folder, tmp_path / "again"))
    # The cube is too small.
    assert [case.name for case in after] == [case.name for case in before] == ["below/bowls", "torus"]
    for one, other in zip(before, after, strict=True):
        assert np.array_equal(one.vertices, other.vertices)
        assert np.array_equal(one.faces, other.faces)
        assert other.vertices.dtype == np.float32
        assert other.faces.dtype == np.int32


def test_largest_meshes_are_left_out_of_a_small_archive(folder, tmp_path, capsys):
    assert pack.main([str(folder), str(tmp_path / "none.tar.xz"), "--most-mb", "0"]) == 0
    assert "left out: torus" in capsys.readouterr().out


def test_first_maps_are_timed_in_slices(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(speed, "WARM", (300,))
    out = tmp_path / "speed.json"
    words = [str(folder), "--device", "cpu", "--resolutions", "8", "12", "--out", str(out)]
    assert speed.main([*words, "--budget-s", "0"]) == 3
    assert "4 of 4 are left" in capsys.readouterr().out
    assert speed.main(words) == 0
    rows = json.loads(out.read_text())["rows"]
    assert [(row["mesh"], row["resolution"]) for row in rows] == [
        ("below/bowls", 8),
        ("torus", 8),
        ("below/bowls", 12),
        ("torus", 12),
    ]
    assert out.with_suffix(".png").is_file()
    # What is there stays.
    assert speed.main(words) == 0
    assert json.loads(out.read_text())["rows"] == rows
    out.write_text("[]")
    assert speed.main(words) == 2


def test_new_meshes_have_new_counts(folder):
    case = next(meshes_of(folder, speed.LEAST))
    mesh = speed.new_mesh(case, "cpu", 2)
    assert mesh.vertices.shape[0] == len(case.vertices) + 2
    assert len(mesh) == len(case)


def test_summary_counts_who_is_slower():
    rows = [
        {
            "mesh": name,
            "resolution": 64,
            "stock_over_first": ratio,
            "stock_over_repeated": 2 * ratio,
            "first_ms": 4.0,
            "repeated_ms": 2.0,
            "wrong": 0,
        }
        for name, ratio in (("slow", 0.25), ("even", 1.0), ("fast", 16.0))
    ]
    found = summaries(rows)["64"]
    assert found["slower_than_stock"] == 1
    assert found["slowest"] == ["slow"]
    assert found["stock_over_first"] == pytest.approx(4 ** (1 / 3))
    assert found["first_over_repeated"] == pytest.approx(2.0)
    assert len(lines({"64": found})[1]) == len(lines({})[0])
