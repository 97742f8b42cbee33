"""Where a recorded call's map goes: to a new tensor each time, whose address kernels take from memory."""

from __future__ import annotations

import threading

import pytest
import torch

from sdm.runtime.output_slot import Place, current_place, placing


def test_each_launch_has_a_new_map_and_its_address():
    place = Place(torch.device("cpu"))
    assert place.put() is None
    assert place.take(torch.zeros(2, 3)) is place.address
    first, second = place.put(), place.put()
    assert first is not None
    assert second is not None
    assert first.shape == second.shape == (2, 3)
    assert first.dtype == torch.float32
    assert first.data_ptr() != second.data_ptr()
    assert place.address.item() == second.data_ptr()


def test_a_call_has_one_map():
    place = Place(torch.device("cpu"))
    place.take(torch.zeros(1))
    with pytest.raises(RuntimeError, match="one map"):
        place.take(torch.zeros(1))


def test_a_place_is_the_threads_own_and_only_while_it_records():
    place, seen = Place(torch.device("cpu")), []
    with placing(place):
        assert current_place() is place
        thread = threading.Thread(target=lambda: seen.append(current_place()))
        thread.start()
        thread.join()
    assert seen == [None]
    assert current_place() is None
    with pytest.raises(ValueError, match="x"), placing(place):
        raise ValueError("x")
    assert current_place() is None
