"""Thresholds of Python's garbage collector during imports, and after them."""

from __future__ import annotations

import gc

import pytest

from sdm.runtime.rare_collections import BETWEEN, rare_collections


@pytest.fixture(autouse=True)
def kept():
    before = gc.get_threshold()
    yield
    gc.set_threshold(*before)


@pytest.mark.parametrize(
    ("before", "during"), [(700, BETWEEN), (BETWEEN + 5, BETWEEN + 5), (0, 0)], ids=["usual", "rarer", "off"]
)
def test_looks_are_rare_meanwhile(before, during):
    gc.set_threshold(before, 8, 9)
    with pytest.raises(ImportError), rare_collections():
        assert gc.get_threshold() == (during, 8, 9)
        raise ImportError
    assert gc.get_threshold() == (before, 8, 9)


def test_what_an_import_sets_stays():
    with rare_collections():
        gc.set_threshold(1234, 5, 6)
    assert gc.get_threshold() == (1234, 5, 6)
