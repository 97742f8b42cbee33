"""Fixtures of the tests on a GPU."""

from __future__ import annotations

import pytest

from sdm.runtime.graphs.captured_call import CapturedCall, TableRecording


@pytest.fixture
def launches(monkeypatch):
    """Number of launches of recordings."""
    counted = []

    def count(kind):
        plain = kind.launch
        monkeypatch.setattr(kind, "launch", lambda *args: counted.append(kind) or plain(*args))

    count(CapturedCall)
    count(TableRecording)
    return counted
