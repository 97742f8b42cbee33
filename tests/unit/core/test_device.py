"""Choice of the device, and refusal of what does not fit into its memory."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch

from sdm.core import device
from sdm.errors import DeviceError, GridError


@pytest.fixture
def two_gpus(monkeypatch):
    """Pretend: choosing touches no device."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 1)


@pytest.fixture
def no_gpu(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


def test_without_a_gpu(no_gpu):
    for wanted in (None, "auto", "cpu", torch.device("cpu")):
        assert device.choose_device(wanted) == torch.device("cpu")
    with pytest.raises(DeviceError, match="the device cuda was requested, but no CUDA device is there; use cpu"):
        device.choose_device("cuda")
    with pytest.raises(DeviceError, match="cuda:1"):
        device.choose_device(torch.device("cuda:1"))


def test_with_gpus(two_gpus):
    assert device.choose_device("cuda:0") == torch.device("cuda:0")
    assert device.choose_device("cuda") == torch.device("cuda:1")
    assert device.choose_device(None) == torch.device("cuda:1")
    assert device.choose_device("auto", torch.zeros(3), None) == torch.device("cuda:1")
    assert device.choose_device("cpu") == torch.device("cpu")
    with pytest.raises(DeviceError, match="cuda:2 was requested, but there are only cuda:0 to cuda:1"):
        device.choose_device("cuda:2")


@pytest.mark.parametrize("name", ["gpu", "", "cuda:x", "cpu:gpu"])
def test_no_such_name(name):
    with pytest.raises(DeviceError, match="there is no device called"):
        device.choose_device(name)


@pytest.mark.parametrize("name", ["meta", "mps", "xpu"])
def test_not_supported(name):
    with pytest.raises(DeviceError, match="not supported; use cpu, cuda"):
        device.choose_device(name)


@pytest.mark.gpu
def test_where_the_tensors_are():
    assert device.choose_device(None, torch.zeros(1), torch.zeros(1, device="cuda:0")) == torch.device("cuda:0")


def test_room(monkeypatch):
    monkeypatch.setattr(device, "free_memory", lambda _: 3 << 30)
    device.require_memory(3 << 30, torch.device("cpu"), "a map")
    with pytest.raises(GridError, match=r"a map needs 4\.5 GiB, but cpu has 3\.0 GiB free; choose a lower resolution"):
        device.require_memory(9 << 29, torch.device("cpu"), "a map")


def test_small_things_are_not_asked_about(monkeypatch):
    monkeypatch.setattr(device, "free_memory", lambda _: 0)
    device.require_memory(1 << 25, torch.device("cpu"), "a map")


def test_a_gpu_is_asked_before_large_maps_alone(monkeypatch):
    gpu, asked = torch.device("cuda:0"), []
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda _: SimpleNamespace(total_memory=64 << 30))
    monkeypatch.setattr(device, "free_memory", lambda _: asked.append(1) or 3 << 30)
    with device.memory_guard(1 << 30, gpu, "a map"):
        assert not asked
    with device.memory_guard(2 << 30, gpu, "a map"):
        assert asked
    with pytest.raises(GridError, match=r"a map needs 4\.5 GiB"), device.memory_guard(9 << 29, gpu, "a map"):
        raise AssertionError
    # What was not asked about is refused as well, if it was too large; other scratch may be what was.
    for needed, kind in ((1 << 30, GridError), (1 << 29, torch.OutOfMemoryError)):
        monkeypatch.setattr(device, "free_memory", lambda _: 1 << 29)
        with pytest.raises(kind), device.memory_guard(needed, gpu, "a map"):
            raise torch.OutOfMemoryError


def test_room_on_a_cpu_is_asked_about(monkeypatch):
    monkeypatch.setattr(device, "free_memory", lambda _: 1 << 20)
    with pytest.raises(GridError), device.memory_guard(1 << 27, torch.device("cpu"), "a map"):
        raise AssertionError


def test_free_memory_of_this_machine():
    free = device.free_memory(torch.device("cpu"))
    assert 1 << 20 < free < 1 << 50


def test_free_memory_without_proc(monkeypatch):
    def missing(*_: object, **__: object) -> None:
        raise FileNotFoundError

    monkeypatch.setattr("builtins.open", missing)
    assert device.free_memory(torch.device("cpu")) > 1 << 20
