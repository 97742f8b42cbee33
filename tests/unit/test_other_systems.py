"""Systems other than Linux: the same code without what Linux alone has."""

from __future__ import annotations

import os

import pytest
import torch

from sdm.core import device
from sdm.errors import FormatError
from sdm.io.files import lock
from sdm.kernels import launch
from sdm.runtime.pipeline.thread_count import threads_beside


def test_cores(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    monkeypatch.delenv("SDM_NUM_THREADS", raising=False)
    assert launch.threads() == 6
    assert threads_beside(torch.device("cpu")) == 3


def test_locks(monkeypatch, tmp_path):
    monkeypatch.setattr(lock, "fcntl", None)
    with lock.alone(tmp_path), lock.alone(tmp_path):
        pass
    with pytest.raises(FormatError, match="no such folder"), lock.alone(tmp_path / "none"):
        pass


def test_memory(monkeypatch, tmp_path):
    monkeypatch.setattr(device, "Path", lambda name: tmp_path / "none")
    assert 1 << 20 < device.free_memory(torch.device("cpu")) < 1 << 50
    monkeypatch.delattr(os, "sysconf")
    assert device.free_memory(torch.device("cpu")) == device.UNKNOWN_MEMORY
