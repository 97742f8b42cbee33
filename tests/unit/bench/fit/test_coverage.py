"""The coverage study: a case is a pure function of its number, done cases are kept, and sums are right."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import pytest
import torch

import sdm.fit.study.simulate
from sdm.bench.fit.coverage import coverage, summarise
from sdm.fit import ExactBackend, Scanner, random_state, simulate
from sdm.shapes import Cochlea


@pytest.fixture
def coarse_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sdm.fit.study.simulate, "FINE", 0.2)


def test_cases_are_pure_functions_of_their_seed(coarse_simulation: None) -> None:
    backend = ExactBackend(Cochlea(1_000), "cpu")
    scanner = Scanner(spacing=0.8, blur=0.3, noise=100.0)
    first, again, other = (random_state(backend, seed) for seed in (4, 4, 5))
    assert torch.equal(first.theta, again.theta)
    assert torch.equal(first.rotation, again.rotation)
    assert not torch.equal(first.theta, other.theta)
    images = [simulate(backend, first, scanner, seed=seed) for seed in (1, 1, 2)]
    assert torch.equal(images[0].values, images[1].values)
    assert images[0].grid.origin != images[2].grid.origin


def test_the_noise_is_the_scanners(coarse_simulation: None) -> None:
    backend = ExactBackend(Cochlea(1_000), "cpu")
    state = random_state(backend, 4)
    quiet, noisy = (
        simulate(backend, state, Scanner(spacing=0.8, blur=0.3, noise=n), seed=1).values.double() for n in (0.0, 100.0)
    )
    assert abs(float((noisy - quiet).std()) - 100) < 5
    assert abs(float(quiet.max()) - 1700) < 1e-3
    assert float(quiet.min()) < 700


def test_summary_counts_intervals_that_hold() -> None:
    records = [
        {"trusted": True, "z": [z] + [0.0] * 9, "deviations": [1.0] * 10, "seconds": 1.0, "number": n, "problems": []}
        for n, z in enumerate([0.0, 1.6, -1.7, 5.0])
    ]
    refused = {"trusted": False, "number": 4, "problems": ["no"]}
    summary = summarise([*records, refused])
    assert summary["cases"] == 5
    assert summary["trusted"] == 4
    assert summary["coverage_90"]["a"] == 0.5
    assert summary["coverage_90"]["alpha"] == 1.0
    assert summary["largest_z"] == 5.0
    assert summary["not_trusted"] == [{"number": 4, "problems": ["no"]}]


def test_no_case_begins_after_the_budget(tmp_path: Path) -> None:
    options = Namespace(
        folder=tmp_path / "cases", backend="exact", device="cpu", weights=None, count=2, budget_s=-1.0, processes=1,
        first=0, out=tmp_path / "out.json",
    )  # fmt: skip
    coverage(options)
    assert list((tmp_path / "cases").iterdir()) == []
    assert (tmp_path / "out.json").is_file()
