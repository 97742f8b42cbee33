"""Report of `sdm sample`: what was told of a mesh once is told again by a run that goes on."""

from __future__ import annotations

import json

import pytest
import trimesh

from sdm.cli.app import main

COUNT = 200


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "in"
    place.mkdir()
    for number in (1, 2):
        trimesh.creation.icosphere(number).export(place / f"{number}.ply")
    return place


@pytest.mark.parametrize("layout", ["deepsdf", "webdataset"])
def test_report_of_a_resumed_run_tells_what_was_told_before(layout, folder, tmp_path, monkeypatch):
    monkeypatch.setattr("sdm.sampling.layouts.webdataset.SHARD_BYTES", 16 * COUNT)
    words = [
        "sample",
        str(folder),
        "-o",
        str(tmp_path / "d"),
        "--layout",
        layout,
        "--device",
        "cpu",
        "--count",
        str(COUNT),
    ]
    assert main(words) == 0
    report = tmp_path / "d" / "report.json"
    whole = json.loads(report.read_text())["meshes"]
    assert all(entry["triangles"] and entry["inside"] for entry in whole)

    def compared(known: list[dict]) -> list[dict]:
        assert main([*words, "--resume"]) == 0
        assert not (tmp_path / "d" / "unfinished.jsonl").exists()
        told = json.loads(report.read_text())["meshes"]
        assert {entry["state"] for entry in told} == {"there already"}
        return [{**entry, "state": "done", "seconds": was["seconds"]} for entry, was in zip(told, known, strict=True)]

    # By the report of a run that came to its end; of one that was cut off by the lines that it left; by the meshes.
    assert compared(whole) == whole
    report.unlink()
    lines = [json.dumps({"number": number, "entry": entry}) for number, entry in enumerate(whole)]
    (tmp_path / "d" / "unfinished.jsonl").write_text("\n".join([*lines, '{"number": 1, "entr']))
    assert compared(whole) == whole
    report.write_text("[]")
    for entry, was in zip(compared(whole), whole, strict=True):
        assert (entry["triangles"], entry["closed"]) == (was["triangles"], was["closed"])
