"""Loop of a worker process: calls of one function, until the process that started it is gone."""

from __future__ import annotations

import os
import pickle
import queue
import threading
from collections.abc import Callable
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any


def serve(link: Connection) -> None:
    """Take the name of a function (`module:function`), then its arguments again and again, and answer each."""
    told: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(link, told), daemon=True).start()
    module, _, name = told.get().decode().partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    while True:
        packed = told.get()
        try:
            # By this thread alone, as it imports: two that import at once see modules that are half done. It comes from
            # the process that started this one.
            answer = None, function(*pickle.loads(packed))  # noqa: S301
        # Whoever asked raises it.
        except Exception as error:  # noqa: BLE001
            answer = error, None
        link.send(answer)


def _listen(link: Connection, told: queue.SimpleQueue[bytes]) -> None:
    try:
        while True:
            told.put(link.recv_bytes())
    except (EOFError, OSError):
        # The process that started this one has no more for it, or was killed: it must not write beside a restart.
        os._exit(0)
