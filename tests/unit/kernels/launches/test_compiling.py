"""Whoever waits for a compiler is told so, once for a device."""

from __future__ import annotations

import logging
import time

from sdm.kernels.launches import compiling


def test_what_takes_long_is_told_once(monkeypatch, caplog):
    monkeypatch.setattr(compiling, "PATIENCE", 0.01)
    monkeypatch.setattr(compiling, "_said", set())
    with caplog.at_level(logging.WARNING, logger="sdm"):
        for _ in range(2):
            with compiling.noticed("cuda:7"):
                for _ in range(200):
                    time.sleep(0.01)
                    if caplog.records:
                        break
    assert len(caplog.records) == 1
    assert "sdm compiles its kernels for cuda:7" in caplog.text


def test_nothing_is_said_of_what_is_there(monkeypatch, caplog):
    monkeypatch.setattr(compiling, "_said", set())
    with caplog.at_level(logging.WARNING, logger="sdm"), compiling.noticed("cpu"):
        pass
    assert not caplog.records
