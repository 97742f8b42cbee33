"""Intervals over cases and seeds against values by hand."""

from __future__ import annotations

import math

import pytest

from sdm.bench.studies.intervals import difference, estimate

THREE = {0: {"a": 1.0, "b": 2.0, "c": 6.0}, 1: {"a": 3.0, "b": 4.0, "c": 8.0}}


def test_an_estimate_by_hand() -> None:
    found = estimate(THREE)
    assert (found.mean, found.median, found.seeds, found.cases) == (4.0, 3.0, 2, 3)
    # Case means 2, 3, 7: their deviation is sqrt(7), and t of two degrees of freedom is 4.3027.
    assert found.half_width == pytest.approx(4.3027 * math.sqrt(7 / 3), rel=1e-4)
    assert found.seeds_sd == pytest.approx(math.sqrt(2.0))
    assert found.cell(1) == "4.0 ± 6.6 (1.4)"
    assert estimate({0: {"a": 1.0}}).cell(2) == "1.00"


def test_differences_are_paired() -> None:
    other = {s: {c: v - 1.0 for c, v in own.items()} for s, own in THREE.items()}
    found = difference(THREE, other)
    assert (found.mean, found.half_width, found.seeds) == (1.0, 0.0, 2)
    baseline = {7: {"a": 0.0, "b": 1.0, "c": 5.0}}
    assert (difference(THREE, baseline).mean, difference(THREE, baseline).half_width) == (2.0, 0.0)


def test_seeds_with_other_cases_are_refused() -> None:
    with pytest.raises(ValueError, match="same cases"):
        estimate({0: {"a": 1.0}, 1: {"b": 1.0}})
    with pytest.raises(ValueError, match="same cases"):
        estimate({})
