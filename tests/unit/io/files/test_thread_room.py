from __future__ import annotations

import threading

from sdm.io.files.thread_room import MOST_KEPT, thread_room


def address(name, size):
    return thread_room(name, size).ctypes.data


def test_it_is_the_same_memory_at_the_next_call():
    thread_room("a", 100)[:] = 7
    again = thread_room("a", 60)
    assert len(again) == 60
    assert (again == 7).all()
    assert address("a", 100) % 4096 == 0
    assert len(thread_room("a", 10_000)) == 10_000


def test_names_and_threads_have_their_own():
    found = [address("a", 100), address("b", 100)]
    thread = threading.Thread(target=lambda: found.append(address("a", 100)))
    thread.start()
    thread.join()
    assert len(set(found)) == 3


def test_too_much_is_not_kept():
    first, second = thread_room("large", MOST_KEPT + 1), thread_room("large", MOST_KEPT + 1)
    assert first.ctypes.data != second.ctypes.data
