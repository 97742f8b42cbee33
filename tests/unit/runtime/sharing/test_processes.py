"""Processes that share work: how they are started."""

from __future__ import annotations

from multiprocessing.context import SpawnProcess
from typing import Any

import pytest

from sdm.runtime.sharing.processes import run_here


class Work:
    """As large as the names of some thousand files."""

    def __init__(self) -> None:
        self.names = b"x" * 200_000


class Started(Exception):
    pass


def test_a_start_does_not_wait_for_the_work_to_be_read(monkeypatch):
    # Whoever starts a process waits until it has read what a pipe does not hold, once it has imported everything.
    handed: list[Any] = []

    def start(process: Any) -> None:
        handed.extend(process._args)
        raise Started

    monkeypatch.setattr(SpawnProcess, "start", start)
    work: Any = Work()
    with pytest.raises(Started):
        run_here(work, [0, 1], ["cpu", "cpu"], print)
    assert handed
    assert not any(isinstance(each, Work | bytes) for each in handed)
