"""Output of a recorded call: a new tensor each time, whose address kernels take from memory."""

from __future__ import annotations

import threading

import pytest
import torch

from sdm.runtime.graphs.output_slot import OutputSlot, capturing_into, current_slot


def test_each_launch_has_a_new_map_and_its_address():
    slot = OutputSlot(torch.device("cpu"))
    assert slot.new_output() is None
    assert slot.bind(torch.zeros(2, 3)) is slot.address
    first, second = slot.new_output(), slot.new_output()
    assert first is not None
    assert second is not None
    assert first.shape == second.shape == (2, 3)
    assert first.dtype == torch.float32
    assert first.data_ptr() != second.data_ptr()
    assert slot.address.item() == second.data_ptr()


def test_a_call_has_one_map():
    slot = OutputSlot(torch.device("cpu"))
    slot.bind(torch.zeros(1))
    with pytest.raises(RuntimeError, match="one map"):
        slot.bind(torch.zeros(1))


def test_a_slot_is_the_threads_own_and_only_while_it_records():
    slot, seen = OutputSlot(torch.device("cpu")), []
    with capturing_into(slot):
        assert current_slot() is slot
        thread = threading.Thread(target=lambda: seen.append(current_slot()))
        thread.start()
        thread.join()
    assert seen == [None]
    assert current_slot() is None
    with pytest.raises(ValueError, match="x"), capturing_into(slot):
        raise ValueError("x")
    assert current_slot() is None
