"""A few trials of every part of the fuzzer: the same ones always, by number."""

from __future__ import annotations

import threading

import pytest

import sdm
from sdm.bench.fuzz import runs
from sdm.bench.fuzz.runs import PARTS, fuzz, run_trial
from sdm.bench.fuzz.trial import Finding, Outcome, one_sentence
from sdm.errors import FormatError

# Some seconds together on an idle core.
TRIALS = {
    "numerics": 8,
    "near_degenerate": 8,
    "paths": 6,
    "mesh_files": 120,
    "map_files": 80,
    "bands": 16,
    "datasets": 8,
    "models": 40,
}
LONG = 60.0


@pytest.mark.parametrize("part", PARTS)
def test_nothing_is_found(part):
    report = fuzz([part], seed=1, minutes=LONG, trials=TRIALS[part])[part]
    assert report["trials"] == TRIALS[part]
    assert not report["findings"]
    # Much of the damage is refused, or nothing was damaged.
    assert part in ("numerics", "near_degenerate", "paths") or report["refused"] > TRIALS[part] // 4


def test_a_trial_is_its_number():
    first = [run_trial("map_files", 3, number) for number in range(4)]
    assert [run_trial("map_files", 3, number) for number in (3, 1)] == [first[3], first[1]]


def test_a_trial_that_hangs_is_ended(monkeypatch):
    monkeypatch.setattr(runs, "MOST_SECONDS", 0.05)
    monkeypatch.setattr("sdm.bench.fuzz.models.trial", lambda *_: threading.Event().wait())
    assert run_trial("models", 0, 0) == (None, "hangs: not done after 0 s")


# Trials that found something: chunks as many as nobody has time for, a record that lost its format, dimensions to
# which a parser counts.
@pytest.mark.parametrize(
    ("part", "seed", "number"), [("bands", 0, 1203), ("map_files", 0, 163), ("mesh_files", 5, 745)]
)
def test_former_findings(part, seed, number):
    assert run_trial(part, seed, number)[1] == ""


def test_processes_share_the_numbers(monkeypatch):
    tried = []
    monkeypatch.setattr(
        runs, "run_trial", lambda part, seed, number: tried.append(number) or (Outcome("x", refused=False), "")
    )
    for process in range(3):
        fuzz(["models"], seed=0, minutes=LONG, first=5 + process, trials=2, step=3)
    assert sorted(tried) == list(range(5, 11))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda values: values * 1.0001, "over_limit"),
        (lambda values: -values, "wrong_signs"),
    ],
)
def test_wrong_values_beside_slivers_are_found(monkeypatch, change, said):
    right = sdm.signed_distance
    monkeypatch.setattr(sdm, "signed_distance", lambda *args, **options: change(right(*args, **options)))
    sentences = [run_trial("near_degenerate", 1, number)[1] for number in range(8)]
    assert any("points" in sentence and f"{said}=0" not in sentence for sentence in sentences)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (KeyError("x"), "part: KeyError: 'x'"),
        (MemoryError(), "part: out of memory"),
        (FormatError("two\nlines"), "refused, but not in one sentence"),
        (FormatError(" "), "refused, but not in one sentence"),
        (Finding("wrong"), "wrong"),
    ],
)
def test_what_is_a_finding(error, said):
    with pytest.raises(Finding, match=said), one_sentence("part"):
        raise error


def test_a_refusal_is_an_outcome():
    with one_sentence("part") as outcome:
        raise FormatError("damaged")
    assert outcome[0].refused
