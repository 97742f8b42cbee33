"""The host's share of `sdm compute`: what `python -m sdm.bench.disk.host_stages` claims, in counts."""

from __future__ import annotations

import json

import pytest
import torch
import trimesh

import sdm.cli.maps.map_stages as stages
from sdm.bench.common.checkout import results_folder
from sdm.bench.disk.host_stages import Options, rows
from sdm.cli.maps.run import run
from sdm.io import load
from sdm.kernels import launch
from tests.helpers.map_settings import map_settings


@pytest.fixture(autouse=True)
def _pool_of_its_own(monkeypatch):
    # Which the bench sets.
    monkeypatch.setenv("SDM_NUM_THREADS", "2")
    yield
    launch._pool.cache_clear()


def test_threads_of_their_own_ask_the_pool_for_nothing(tmp_path):
    options = Options(meshes=2, triangles=5000, resolution=8, threads=(2,), rounds=1, pool=4, folder=tmp_path)
    found = {(row["stage"], row["format"]): row for row in rows(options)}
    assert len(found) == 4
    assert not any(row["pool_tasks"] for row in found.values())


def test_the_record_says_what_the_pages_say():
    record = json.loads((results_folder() / "disk-host-cpu.json").read_text())
    found = {(row["stage"], row["format"], row["threads"]): row for row in record["rows"]}
    assert all(row["pool_tasks"] == 0 for row in found.values())
    for threads in (1, 8):
        assert found["read", "npz", threads]["cpu_ms"] + found["write", "npz", threads]["cpu_ms"] < 10


def test_readers_of_the_record_reach_100_megabytes_a_second():
    record = json.loads((results_folder() / "disk-readers-cpu.json").read_text())
    own = {(row["ending"], row["triangles"]): row["mb_per_s"] for row in record["readers"] if row["reader"] == "sdm"}
    assert {ending for ending, _ in own} == {"ply", "stl", "obj", "off"}
    assert min(own.values()) > 100


def test_compute_with_several_threads_uses_no_pool_beside_the_device(tmp_path, monkeypatch, capsys):
    jobs = []
    for number in range(3):
        trimesh.creation.icosphere(4, radius=1 + number).export(tmp_path / f"{number}.ply")
        jobs.append((tmp_path / f"{number}.ply", tmp_path / f"{number}.npz"))
    settings = map_settings(8)
    seen: dict[str, set[bool]] = {"read": set(), "measure": set(), "write": set()}
    for name in seen:

        def noted(self, given, name=name, plain=getattr(stages.MapStages, name)):
            seen[name].add(launch._sharing.is_off)
            return plain(self, given)

        monkeypatch.setattr(stages.MapStages, name, noted)
    assert run(jobs, settings, workers=2) is None
    assert seen == {"read": {True}, "measure": {False}, "write": {True}}
    many = [load(target).values for _, target in jobs]
    # One mesh alone has all threads.
    for job, values in zip(jobs, many, strict=True):
        assert run([job], settings) is None
        assert torch.equal(values, load(job[1]).values)
    assert seen["read"] == seen["write"] == {True, False}
