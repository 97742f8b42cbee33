"""The simulation of a pipeline: cases that can be worked out by hand, and the records that its page goes by."""

from __future__ import annotations

import json

import numpy as np
import pytest

from sdm.bench.common.checkout import results_folder
from sdm.bench.disk import simulate
from sdm.bench.disk.queues import Pipeline
from sdm.bench.disk.simulate import OBJAVERSE, costs, from_record, from_run


def pipeline(read: float, measure: float, write: float, readers: int = 1, writers: int = 1, together: int = 1):
    return Pipeline(
        readers=readers,
        writers=writers,
        together=together,
        **{name: constant(value) for name, value in (("read", read), ("measure", measure), ("write", write))},
    )


def constant(seconds: float):
    return lambda count: np.full(count, seconds)


def test_the_slowest_stage_decides():
    # Reading of the first, then each measured once the one before was, then the last one's writing.
    assert pipeline(1, 3, 2).seconds(10) == pytest.approx(1 + 10 * 3 + 2)
    assert pipeline(3, 1, 1).seconds(10) == pytest.approx(10 * 3 + 1 + 1)
    assert pipeline(1, 1, 3).seconds(10) == pytest.approx(1 + 1 + 10 * 3)


def test_threads_share_a_stage():
    assert pipeline(4, 1, 1, readers=4).seconds(8) == pytest.approx(4 + 4 + 4 + 1)
    assert pipeline(1, 1, 4, writers=4).seconds(8) == pytest.approx(1 + 8 + 4)
    # Two writers of four seconds each write one item in two.
    assert pipeline(0, 1, 4, writers=2).seconds(100) == pytest.approx(100 * 2 + 1, abs=4)


def test_calls_wait_for_all_of_their_items():
    # Eight are read one after the other before the first call begins.
    assert pipeline(1, 2, 0, together=8).seconds(8) == pytest.approx(8 + 2)
    assert pipeline(1, 2, 0, together=8).seconds(16) == pytest.approx(16 + 2)
    # The last call has fewer.
    assert pipeline(0, 5, 0, together=8).seconds(17) == pytest.approx(3 * 5)


def test_what_is_held_is_bounded():
    """Behind a writer that never ends its first item the caller stops after two more."""
    written = np.array([1000.0, *[0.0] * 99])
    model = Pipeline(
        readers=1, writers=1, together=1, read=constant(0), measure=constant(1), write=lambda count: written[:count]
    )
    # Two are held by the writer; the other 98 are measured after it.
    assert model.seconds(100) == pytest.approx(1 + 1000 + 98, abs=2)


def test_costs_are_those_of_equal_shares():
    found = costs(pipeline(0, 0.01, 0))
    assert set(found["simulated_per_second"]) == {"1000", "10000", "100000"}
    assert found["simulated_per_second"]["100000"] == pytest.approx(100, rel=0.01)
    assert found[f"hours_of_{OBJAVERSE}_on_8"] == pytest.approx(OBJAVERSE / 8 / 100 / 3600, abs=0.01)


def test_a_record_that_was_measured():
    """Reading, calls and writing by mean times come to the seconds that were measured, within a tenth."""
    record = json.loads((results_folder() / "disk-cuda.json").read_text())
    for work in ("compute .npz", "compute .nii.gz"):
        found = from_record(record, work)
        assert found["simulated_seconds"] == pytest.approx(found["measured_seconds"], rel=0.1)
    with pytest.raises(SystemExit, match=r"no row 'other', but compute \.npz"):
        from_record(record, "other")


def test_a_run_of_its_own(tmp_path):
    """Twenty small files: the times of each stage, and all that the page names."""
    found = from_run(tmp_path, 40, 6, "cpu")
    assert found["files"] == 40
    assert set(found["busy_ms_each"]) == {"read", "cpu", "write"}
    assert found["measured_seconds"] > 0
    assert found["simulated_over_measured"] > 0
    assert len(list((tmp_path / "maps").rglob("*.npz"))) >= 40


def test_the_command_by_a_record(tmp_path, monkeypatch, capsys):
    path = results_folder() / "disk-cuda.json"
    monkeypatch.setattr("sys.argv", ["simulate", "--stages", str(path), "--out", str(tmp_path / "found.json")])
    simulate.main()
    assert json.loads(capsys.readouterr().out) == json.loads((tmp_path / "found.json").read_text())
