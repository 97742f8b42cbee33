"""Mailbox of the newest value of each control: what comes while the last ones are drawn replaces what waits."""

from __future__ import annotations

import queue
import threading
from typing import Any


class NewestValues:
    """Values put by any thread, and taken by one.

    A slider that is dragged says more values than can be drawn; those between are dropped, so that what is shown is
    never more than one drawing late.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        # Its `put` may be called by a signal's handler, which must take no lock that the interrupted thread may hold.
        self._wake: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._waiting: dict[str, Any] = {}
        self.ended = False

    def put(self, name: str, value: Any) -> None:
        """Replace the value that waits under a name."""
        with self._lock:
            self._waiting[name] = value
        self._wake.put(None)

    def end(self) -> None:
        """Let `take` return at once from now on."""
        self.ended = True
        self._wake.put(None)

    def take(self, timeout: float | None = None) -> dict[str, Any]:
        """All that waits, by name, once there is any; empty after `timeout` seconds or `end`."""
        while not self.ended:
            try:
                self._wake.get(timeout=timeout)
            except queue.Empty:
                return {}
            with self._lock:
                found, self._waiting = self._waiting, {}
            if found:
                return found
        return {}
