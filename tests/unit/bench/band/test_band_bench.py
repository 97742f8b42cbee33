from __future__ import annotations

import pytest

from sdm.bench.band import job, peak_memory
from sdm.bench.band.figures import draw
from sdm.bench.band.job import measure
from sdm.bench.common.meshes import load_case
from sdm.bench.peers import openvdb


@pytest.fixture
def uncached():
    openvdb._program.cache_clear()
    openvdb.missing.cache_clear()
    yield
    openvdb._program.cache_clear()
    openvdb.missing.cache_clear()


def test_a_row_has_errors_and_memory(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["peak_memory", "sphere", "40", "3.0"])
    peak_memory.main()
    peak = int(capsys.readouterr().out)
    monkeypatch.setattr(job, "_peak", lambda *_: peak)
    (row,) = measure(load_case("sphere"), "cpu", 40, 3.0, 50, 1, with_peer=False)
    assert row["library"] == "sdm"
    assert row["samples"] == 50
    assert row["error"] < 1e-4
    assert row["signs"] == 0
    assert row["peak"] > 0
    draw({"rows": [row], "machine": {"device": "a CPU", "cores": 2}, "half_width": 3.0}, tmp_path / "band.png")
    assert (tmp_path / "band.png").stat().st_size > 1000


def test_a_peer_that_does_not_compile_says_why(monkeypatch, uncached):
    monkeypatch.setenv("CXX", "/bin/false")
    note = openvdb.missing()
    assert note is not None
    assert note.startswith("OpenVDB is left out")
