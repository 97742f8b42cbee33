"""The comparison and the accuracy report run from end to end, and notice wrong answers."""

from __future__ import annotations

import json

import numpy as np
import pytest

import sdm
from sdm.bench.common.correctness import compare, rounding, voxel_centres
from sdm.bench.common.grids import TURN
from sdm.bench.common.meshes import load_case
from sdm.bench.dense import accuracy
from sdm.bench.dense import compare as comparison
from sdm.bench.peers import Sdm
from sdm.cli import main

pytestmark = pytest.mark.filterwarnings("default")


def bench(words):
    return main(["bench", *words])


def test_comparison(tmp_path, capsys):
    out = tmp_path / "results.json"
    words = ["--device", "cpu", "--quick", "--budget-s", "0.5", "--meshes", "sphere", "--resolutions", "8"]
    assert bench([*words, "--points", "300", "--peers", "SDM", "winding", "--out", str(out)]) == 0
    report = json.loads(out.read_text())
    assert [result["title"] for result in report["results"]] == ["sphere at 8^3", "sphere at 300 points"]
    for result in report["results"]:
        rows = {row["peer"]: row for row in result["rows"]}
        assert rows["sdm"]["wrong_signs"] == 0
        assert rows["sdm"]["max_error"] <= 4
        assert rows["Warp winding number"]["million_per_second"] > 0
    printed = capsys.readouterr().out
    assert "sphere at 8^3 (3,968 triangles)" in printed
    assert "Warp winding number" in printed


def test_a_fast_map_is_timed_whole_even_where_points_are_slow(tmp_path, monkeypatch):
    out = tmp_path / "results.json"
    monkeypatch.setattr(comparison, "_affordable", lambda peer, question, budget: (250, 0.0))
    assert (
        bench(["--device", "cpu", "--meshes", "cube", "--resolutions", "8", "--peers", "sdm", "--out", str(out)]) == 0
    )
    (row,) = json.loads(out.read_text())["results"][0]["rows"]
    assert row["asked"] == 512


def test_a_slow_peer_is_asked_less(tmp_path, monkeypatch):
    out = tmp_path / "results.json"
    monkeypatch.setattr(comparison, "_whole_map_fits", lambda peer, question, budget: False)
    monkeypatch.setattr(comparison, "_affordable", lambda peer, question, budget: (250, 0.0))
    assert (
        bench(["--device", "cpu", "--meshes", "cube", "--resolutions", "8", "--peers", "sdm", "--out", str(out)]) == 0
    )
    (row,) = json.loads(out.read_text())["results"][0]["rows"]
    assert (row["asked"], row["points"]) == (250, 250)


def test_bad_choices_are_one_sentence(capsys):
    assert bench(["--peers", "nothing"]) == 2
    assert "no peer's name holds any of nothing" in capsys.readouterr().err
    assert bench(["--device", "cpu", "--peers", "sdm", "--meshes", "teapot"]) == 2
    assert "no mesh called 'teapot'" in capsys.readouterr().err


def test_wrong_answers_are_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr(Sdm, "signed_distance_map", lambda self, grid: self._index.signed_distance_map(grid).values + 1)
    assert bench(["--device", "cpu", "--quick", "--meshes", "cube", "--resolutions", "8", "--peers", "sdm"]) == 1


def test_accuracy_report(tmp_path, monkeypatch, capsys):
    out = tmp_path / "accuracy.json"
    words = ["--device", "cpu", "--points", "400", "--resolution", "8", "--meshes", "cube", "--out", str(out)]
    assert accuracy.main(words) == 0
    report = json.loads(out.read_text())
    assert report["meshes"]["cube"]["fine"]
    assert report["meshes"]["cube"]["points"] == 400
    assert "1 of 1 meshes keep every limit" in out.with_suffix(".md").read_text()

    good = sdm.signed_distance
    monkeypatch.setattr(
        sdm, "signed_distance", lambda *a, **k: -good(*a, **k) if "return_closest" not in k else good(*a, **k)
    )
    assert accuracy.main([*words, "--resume"]) == 0
    assert accuracy.main(words) == 1
    assert "BREAKS A LIMIT" in capsys.readouterr().out
    assert json.loads(out.read_text())["meshes"]["cube"]["kinds"]["near"]["wrong_signs"] > 100


@pytest.mark.parametrize("direction", [np.eye(3), TURN])
def test_voxel_centres_are_the_grids(direction):
    grid = sdm.Grid((0.1, -3.3, 1e4), (0.3, 0.07, 0.9), (7, 11, 5), direction)
    which = np.array([0, 5, 54, 200, 384])
    np.testing.assert_array_equal(voxel_centres(grid, which), grid.points().numpy().reshape(-1, 3)[which])
    np.testing.assert_array_equal(voxel_centres(grid), grid.points().numpy().reshape(-1, 3))


def test_what_counts_as_wrong():
    case = load_case("cube")
    points = np.array([[0, 0, 0], [3, 0, 0], [1, 0, 0], [1.5, 0, 0], [0, 0.5, 0]], np.float32)
    unit = rounding(case, points)
    np.testing.assert_array_equal(unit, 2.0**-24 * np.array([1, 3, 1, 1.5, 1]))
    truth, winding = np.array([1, 2, 0, 0.5, 0.5]), np.array([1, 0, 0.3, 0.5, 1])
    exact = np.array([-1, 2, -1e-9, -0.5, -0.5])
    fine = compare(case, points, exact, truth, winding)
    assert fine.fine
    assert (fine.unclear, fine.on_surface, fine.wrong_signs) == (1, 1, 0)
    assert compare(case, points, -exact, truth, winding).wrong_signs == 3
    off = exact + np.array([0, 5 * unit[1], 0, 0, 0])
    assert compare(case, points, off, truth, winding).over_limit == 1
    assert compare(case, points, np.where(truth == 2, np.nan, exact), truth, winding).max_error == np.inf
