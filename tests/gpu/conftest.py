"""Fixtures of the tests on a GPU."""

from __future__ import annotations

import pytest

from sdm.runtime.graphs.captured_call import CapturedCall


@pytest.fixture
def launches(monkeypatch):
    """Number of launches of recordings."""
    counted = []
    plain = CapturedCall.launch
    monkeypatch.setattr(CapturedCall, "launch", lambda *args: counted.append(1) or plain(*args))
    return counted
