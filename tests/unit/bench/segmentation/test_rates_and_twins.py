"""Rates are chosen by shapes that no score is of, and near twins are on one side."""

from __future__ import annotations

import time

from sdm.bench.segmentation import ensembles, juhl, juhl_shapes, report
from sdm.bench.segmentation.juhl_shapes import shapes
from sdm.bench.segmentation.log_file import LogFile
from tests.helpers.segmentation_cases import volume, write_hdf5


def test_no_near_twin_of_a_validation_case_is_trained_on(tmp_path, monkeypatch):
    """0RZD is a near twin of 5QFK; MK is of nobody."""
    record = {"names": ["0RZD", "MK", "CMPX", "5QFK"], "limit_mm": 1.0}
    apart = [[0, 9, 0, 0.9], [9, 0, 9, 9], [0, 9, 0, 0.9], [0.9, 9, 0.9, 0]]
    monkeypatch.setattr(ensembles, "read_record", lambda: {**record, "distances_mm": apart})
    for part, names in (("train", ("0RZD", "MK")), ("val", ("5QFK",))):
        for name in names:
            write_hdf5(tmp_path / part / f"{name}.h5", *volume(0))
    job = {"data": str(tmp_path), "cases": None}
    for twins, left in (("apart", ["MK"]), ("kept", ["0RZD", "MK"])):
        cases = ensembles.cases_of({**job, "twins": twins}, "train", {})
        assert [case.name for case in cases] == left


def test_rates_are_chosen_by_the_validation_shapes_of_each_network(tmp_path):
    """Two rates, two seeds at tiny size; the first seed's test is of the network that was chosen."""
    logs = LogFile(tmp_path / "logs.jsonl")
    words = "run --seeds 0 1 --networks pwc-ce --rates 0.01 0.03 --steps 2 --batch 1 --filters 2 --fine 32 --coarse 16"
    options = juhl.parser().parse_args(words.split())
    listed = juhl.jobs(options)
    assert [job["name"] for job in listed] == ["pwc-ce-rate-0.01", "pwc-ce-rate-0.03", "pwc-ce-0", "pwc-ce-1"]
    few = {
        part: [s for _, s in zip(range(2), shapes(part, 32, 16, "cpu"), strict=False)] for part in juhl_shapes.SPLITS
    }
    for job in listed:
        log = juhl.work(job, "cpu", tmp_path, dict(few), time.monotonic() + 600, logs=logs)
        assert log is not None
        logs.put({"seconds": 1.0, **log})
    errors = juhl.rates_of(logs, "pwc-ce")
    assert set(errors) == {0.01, 0.03}
    by_name = {log["job"]["name"]: log for log in logs.trainings()}
    best = min(errors, key=errors.__getitem__)
    for seed in (0, 1):
        assert by_name[f"pwc-ce-{seed}"]["job"]["settings"]["learning_rate"] == best
        assert "validation" not in by_name[f"pwc-ce-{seed}"]
    assert by_name["pwc-ce-0"]["losses"] == by_name[f"pwc-ce-rate-{best:g}"]["losses"]
    assert "linear" not in by_name["pwc-ce-rate-0.01"]
    text = juhl.tables_of(logs)
    assert "PWC (CE), nearest (as published) (2)" in text
    assert f"**{100 * (1 - errors[best]):.2f}**" in text
    assert "a rate of its own for each network" in report.page(*[LogFile(tmp_path / "none.jsonl")] * 3, rates=logs)


def test_the_parts_of_the_shapes_have_no_shape_in_common():
    taken = [number for first, count in juhl_shapes.SPLITS.values() for number in range(first, first + count)]
    assert len(taken) == len(set(taken)) == 28
