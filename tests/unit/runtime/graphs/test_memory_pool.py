"""Inputs that a recording holds already, and when they have to be copied again."""

from __future__ import annotations

import torch

from sdm.runtime.graphs.memory_pool import InputCache, MemoryPool


def test_faces_are_copied_again_once_they_changed_or_another_recording_was_launched():
    pool = MemoryPool()
    one, other = InputCache(pool, 2), InputCache(pool, 2)
    faces, again = torch.zeros(4, 3, dtype=torch.int32), torch.zeros(4, 3, dtype=torch.int32)

    def launched(held, *given):
        """Inputs that were there already."""
        held.begin()
        found = [held.holds(index, tensor) for index, tensor in enumerate(given)]
        for index, tensor in enumerate(given):
            held.copied(index, tensor)
        return found

    moving = torch.zeros(5, 3)
    assert launched(one, moving, faces) == [False, False]
    assert launched(one, moving, faces) == [False, True]
    assert launched(one, moving, again) == [False, False]
    assert launched(one, moving, again) == [False, True]
    again[0] = 1
    assert launched(one, moving, again) == [False, False]
    # Its scratch may have been where the inputs of the first lie.
    assert launched(other, moving, faces) == [False, False]
    assert launched(one, moving, again) == [False, False]
    assert launched(one, moving, again) == [False, True]
    with torch.inference_mode():
        uncounted = torch.zeros(4, 3, dtype=torch.int32)
    assert [launched(one, moving, uncounted) for _ in range(2)] == [[False, False]] * 2
