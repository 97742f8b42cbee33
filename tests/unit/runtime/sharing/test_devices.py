"""Devices of a machine that make a dataset."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import DeviceError
from sdm.runtime.sharing.devices import devices_for


@pytest.fixture
def gpus(monkeypatch):
    def have(*names: str) -> None:
        monkeypatch.setattr(torch.cuda, "is_available", lambda: bool(names))
        monkeypatch.setattr(torch.cuda, "device_count", lambda: len(names))
        monkeypatch.setattr(torch.cuda, "get_device_name", lambda device: names[device.index])

    return have


def test_every_gpu_of_one_kind(gpus):
    gpus("H100", "H100", "T4", "H100")
    assert devices_for(None) == devices_for("auto") == ["cuda:0", "cuda:1", "cuda:3"]


def test_the_cpu_where_there_is_none(gpus):
    gpus()
    assert devices_for(None) == ["cpu"]
    with pytest.raises(DeviceError, match="no CUDA device"):
        devices_for("cuda")


def test_one_that_is_asked_for(gpus):
    gpus("H100")
    assert devices_for("cpu") == ["cpu"]
