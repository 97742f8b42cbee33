"""Locks of folders: refused or waited for."""

from __future__ import annotations

import threading

import pytest

from sdm.errors import FormatError
from sdm.io.files.lock import alone


def test_the_second_is_refused_or_waits(tmp_path):
    order = []

    def second():
        with alone(tmp_path, wait=True):
            order.append("second")

    with alone(tmp_path):
        with pytest.raises(FormatError, match="is being written by another process"), alone(tmp_path):
            pass
        waiting = threading.Thread(target=second)
        waiting.start()
        waiting.join(0.2)
        order.append("first")
    waiting.join(30)
    assert order == ["first", "second"]


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(FormatError, match=r"none cannot be written"), alone(tmp_path / "none"):
        pass
