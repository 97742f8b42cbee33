"""The stream's benchmark runs, on small sizes where there is no GPU, and writes what it found part by part."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import time

import pytest
import torch

from sdm.bench.stream.__main__ import Results, main
from sdm.bench.stream.networks import NETWORKS
from sdm.bench.stream.sizes import Bench

pytestmark = pytest.mark.skipif(torch.cuda.is_available(), reason="on a GPU it takes minutes")


def run(monkeypatch, out, *words) -> dict:
    monkeypatch.setattr("sys.argv", ["stream", "--device", "cpu", "--out", str(out), *map(str, words)])
    main()
    return json.loads(out.read_text())


@pytest.mark.slow
def test_it_runs_and_writes_its_results(tmp_path, monkeypatch):
    found = run(monkeypatch, tmp_path / "a.json", "--parts", "rates", "training", "endurance")
    assert all(row["maps_per_second"] > 0 for row in found["rates"]["batches"])
    assert all(found["training"][name]["streamed_to_cached"] > 0 for name in NETWORKS)
    assert found["machine"]["versions"]["torch"]
    assert found["endurance"]["batches"] == 200
    assert found["endurance"]["finite"]


@pytest.mark.slow
def test_two_processes_give_the_scaling(tmp_path, root):
    out = tmp_path / "two.json"
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m"]
    subprocess.run(
        [*command, "sdm.bench.stream", "--parts", "training", "--device", "cpu", "--out", str(out)],
        check=True,
        capture_output=True,
        cwd=root,
        timeout=120,
    )
    found = json.loads(out.read_text())["training"]
    assert found["processes"] == 2
    ratio = found["together"]["streamed_samples_per_second"] / found["alone"]["streamed_samples_per_second"] / 2
    assert found["scaling"]["streamed"] == pytest.approx(ratio)


def test_what_does_not_fit_is_left_out_and_said(tmp_path, monkeypatch):
    found = run(monkeypatch, tmp_path / "a.json", "--budget-s", 1, "--parts", "rates", "reading")
    assert set(found) == {"machine", "rates", "reading"}
    assert all("s were left" in found[name]["left_out"] for name in ("rates", "reading"))


def test_parts_of_the_same_machine_stay(tmp_path):
    path = tmp_path / "a.json"
    Results(path, {"device": "one"}).add("rates", {"x": 1})
    Results(path, {"device": "one"}).add("training", {"y": 2})
    assert json.loads(path.read_text()) == {"machine": {"device": "one"}, "rates": {"x": 1}, "training": {"y": 2}}
    Results(path, {"device": "one"}).leave_out("rates", "no time")
    assert json.loads(path.read_text())["rates"] == {"x": 1}
    Results(path, {"device": "two"}).add("training", {"y": 3})
    assert json.loads(path.read_text()) == {"machine": {"device": "two"}, "training": {"y": 3}}


def test_batches_that_are_there_already_do_not_make_a_stream_seem_fast():
    bench = Bench("cpu")
    made = itertools.count()

    def call() -> None:
        if next(made) % 64 == 0:
            time.sleep(0.01)

    # As many as are made in a measurement's time, and not the thousands of times as many that are handed out in it.
    assert bench.calls(call) <= 2 * 64 * bench.seconds / 0.01
