"""A device made ready beside the imports of a command: nothing of it may be seen but time."""

from __future__ import annotations

import pytest
import torch

from sdm.runtime import early_device


def test_a_cpu_needs_nothing():
    assert early_device.begin("cpu") is None


@pytest.mark.parametrize("device", ["auto", "cuda:99", "no such device"])
def test_what_is_not_there_is_not_this_thread_s_to_say(device, capfd):
    thread = early_device.begin(device)
    assert thread is not None
    thread.join()
    assert capfd.readouterr() == ("", "")


def test_the_kinds_of_kernels_are_called(monkeypatch):
    """On a CPU in place of a GPU: all calls are right."""
    waited = []
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "synchronize", waited.append)
    thread = early_device.begin("cpu:0")
    assert thread is not None
    thread.join()
    assert waited == [torch.device("cpu:0")]
