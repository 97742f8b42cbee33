"""Garbage collection around the imports of a command."""

from __future__ import annotations

import gc

import pytest

from sdm.cli.common.imports_that_stay import imports_that_stay


@pytest.fixture(autouse=True)
def thawed():
    assert gc.isenabled()
    gc.unfreeze()
    yield
    gc.unfreeze()
    gc.enable()


def test_what_is_made_is_old_at_once():
    with imports_that_stay():
        assert not gc.isenabled()
        made = [[] for _ in range(5000)]
    assert gc.isenabled()
    young = {id(one) for generation in (0, 1) for one in gc.get_objects(generation)}
    assert not young & {id(one) for one in made}
    assert not gc.get_freeze_count()


def test_what_is_frozen_stays_frozen():
    gc.freeze()
    count = gc.get_freeze_count()
    with imports_that_stay():
        pass
    assert gc.get_freeze_count() >= count - 1000
    assert gc.isenabled()


def test_who_turned_it_off_finds_it_off():
    gc.disable()
    with imports_that_stay():
        pass
    assert not gc.isenabled()
