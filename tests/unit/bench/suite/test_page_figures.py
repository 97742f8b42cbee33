"""Figures of public pages are those of their records."""

from __future__ import annotations

import re

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


def test_records_name_their_commits_and_the_page_of_old_ones_has_them(root):
    ages = (root / "bench" / "README.md").read_text().split("## Records and their age", 1)[1].split("\n## ", 1)[0]
    rows = [line for line in ages.splitlines() if line.startswith("| `")]
    named = {"surrogate-wavy-torus-cpu"}
    for path in sorted((root / "bench" / "results").glob("*.json")):
        commits = set(re.findall(r'"commit": "([0-9a-f]{7})', path.read_text()))
        # Coverage has a commit as the key of each entry.
        assert commits or path.stem in named or re.match(r'\{\s*"[0-9a-f]{12}"', path.read_text()), path.name
        for row in rows:
            if f"`{path.name}`" in row.split("|")[1] and "several of" not in row:
                assert any(commit in row for commit in commits), (path.name, commits)
