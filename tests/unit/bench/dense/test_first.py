"""Benchmarks of first calls and of frames, in miniature, and what they rest on."""

from __future__ import annotations

import json

import torch

from sdm.bench.common.meshes import load_case
from sdm.bench.dense import first, live
from sdm.topology.face_pairing import pairing_of


def test_a_split_mesh_is_closed_and_has_other_counts() -> None:
    case = load_case("torus-200")
    other = first.split(case, 5)
    assert len(other) == len(case) + 10
    assert len(other.vertices) == len(case.vertices) + 5
    assert pairing_of(torch.from_numpy(other.faces), len(other.vertices)).unmatched.shape[0] == 0


def test_a_row_has_both_calls_and_equal_maps() -> None:
    found = first.row(load_case("torus-200"), "cpu", 12, variants=2, runs=2)
    assert found["equal"]
    assert 0 < found["first_host_us"] <= 1e3 * found["first_slowest_ms"] * 1.01
    assert found["ratio"] == found["first_ms"] / found["repeated_ms"]


def test_all_ways_of_a_frame_give_the_map_of_a_plain_call(tmp_path, monkeypatch, capsys) -> None:
    out = tmp_path / "live.json"
    given = ["live", "--device", "cpu", "--triangles", "200", "--frames", "3", "--resolutions", "12", "--out", str(out)]
    monkeypatch.setattr("sys.argv", given)
    live.main()
    rows = json.loads(out.read_text())["rows"]
    assert [found["way"] for found in rows] == ["update", "signed_distance_map", "signed_distance_maps"]
    assert all(found["equal"] and found["frame_ms"] > 0 for found in rows)
    assert out.with_suffix(".png").is_file()
    assert "maps differ" not in capsys.readouterr().out
