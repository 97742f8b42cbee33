"""The DeepSDF study: what is trained, how a rate is chosen, and its tables."""

from __future__ import annotations

import argparse
import sys

import pytest

from sdm.bench.deepsdf.study import __main__ as study
from sdm.bench.deepsdf.study import jobs as study_jobs
from sdm.bench.deepsdf.study import study_tables
from sdm.bench.deepsdf.study.jobs import METHODS, rates_of, settings_of
from sdm.bench.segmentation.log_file import LogFile

SCORES = ("chamfer_paper", "chamfer_paper_floor", "emd", "emd_floor", "accuracy", "completion", "normal_cosine",
          "mean_mm", "percentile95_mm", "dice", "seen_mm", "other_mm")  # fmt: skip


def options(monkeypatch: pytest.MonkeyPatch, *words: str) -> argparse.Namespace:
    monkeypatch.setattr(sys, "argv", ["study", "run", *words])
    return study.parser().parse_args()


def rows(value: float) -> dict[str, dict[str, float]]:
    return {case: dict.fromkeys(SCORES, value + n) for n, case in enumerate(("a", "b", "c"))}


def test_codes_are_of_equal_size() -> None:
    assert METHODS["published"].code_size == METHODS["local-256"].code_size == 256
    assert METHODS["local"].code_size == 14_912
    assert all(size**3 <= code for size, code in zip(study_jobs.MAPS, (256, 14_912), strict=True))


def test_all_methods_have_the_same_rates_steps_and_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    listed = study.jobs(options(monkeypatch))
    kinds = [job["kind"] for job in listed]
    assert kinds == ["rate"] * 9 + ["baselines"] + ["test"] * 9
    made = {job["name"]: settings_of(job) for job in listed if job["kind"] == "rate"}
    for setting in ("epochs", "shapes", "points"):
        assert len({getattr(s, setting) for s in made.values()}) == 1
    for method in METHODS:
        rates = [s.decoder_rate for name, s in made.items() if name.startswith(f"{method}-rate")]
        assert sorted(rates) == list(study.RATES)
    # Codes keep their share of the network's rate.
    assert made["published-rate-0.0005"].code_rate == pytest.approx(1e-3)
    only = study.jobs(options(monkeypatch, "--methods", "local", "--no-baselines", "--seeds", "5", "--rates", "0.1"))
    assert [job["name"] for job in only] == ["local-rate-0.1", "local-5"]


def test_tables_and_picture(tmp_path) -> None:
    logs = LogFile(tmp_path / "study.jsonl")
    for rate, found in ((0.1, 3.0), (0.2, 2.0)):
        job = {"name": f"local-rate-{rate}", "kind": "rate", "method": "local", "rate": rate}
        logs.put(
            {
                "job": {**job, "seed": 0},
                "validation_mm": found,
                "validation": rows(found),
                "machine": {"device": "a CPU", "commit": "abc"},
            }
        )
    for seed in (0, 1):
        job = {"name": f"local-{seed}", "kind": "test", "method": "local", "seed": seed}
        parts = {part: rows(1.0 + seed) for part in ("known", "unseen", "half")}
        logs.put({"job": job, "machine": {"device": "a CPU", "commit": "abc"}, **parts})
    copies = {name: rows(4.0) for name in study_tables.COPIES}
    log = {"job": {"name": "baselines", "kind": "baselines"}, "unseen": copies, "half": copies}
    logs.put({**log, "machine": {"device": "a CPU", "commit": "abc"}})
    assert rates_of(logs, "local") == {0.1: 3.0, 0.2: 2.0}
    text = study_tables.tables(logs)
    assert "| local codes, 14,912 numbers | 3.000 | **2.000** |" in text
    # Cases 1.5, 2.5, 3.5 by two seeds that are 1 apart, and the median beside the mean.
    assert "| local codes, 14,912 numbers (2) | 2.500 ± 2.484 (0.707); 2.500 |" in text
    assert "- local codes, 14,912 numbers, other half [mm]: -2.500 ± 0.000 against the copy, -2.500" in text
    # Of the better rate, cases 2, 3 and 4.
    assert text.count("| local codes, 14,912 numbers (1) | 3.000 ± 2.484; 3.000 |") == 1
    assert "| copy of the nearest training shape (1) |" in text
    assert text in study_tables.page(logs)
    assert "On a CPU, commit abc." in study_tables.page(logs)
    study_tables.picture(logs, tmp_path / "study.png")
    assert (tmp_path / "study.png").stat().st_size > 10_000


def test_no_logs_no_table(tmp_path) -> None:
    assert "no logs yet" in study_tables.tables(LogFile(tmp_path / "none.jsonl"))
