"""Figures of public pages are those of their records."""

from __future__ import annotations

import pytest

from sdm.bench.common.checkout import checkout
from sdm.bench.suite import page_figures
from sdm.bench.suite.page_figures import FIGURES, out_of_step

pytestmark = pytest.mark.skipif(checkout() is None, reason="pages and records are in a checkout")


def test_pages_say_what_their_records_hold():
    assert out_of_step() == []


def test_another_record_is_found(monkeypatch):
    sampling = page_figures.record("sampling-cpu")
    other = {**sampling, "samples": {**sampling["samples"], "per_second": 2e6}}
    monkeypatch.setattr(page_figures, "record", lambda name: other)
    monkeypatch.setattr(page_figures, "TABLES", ())
    monkeypatch.setattr(page_figures, "FIGURES", tuple(f for f in FIGURES if f.record == "sampling-cpu"))
    (sentence,) = out_of_step()
    assert "cores 2.00 million" in sentence
