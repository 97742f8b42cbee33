"""Loop of a worker process: calls of one function, until the process that started it is gone."""

from __future__ import annotations

import os
import pickle
import queue
import threading
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any


def serve(links: Sequence[Connection]) -> None:
    """Take the name of a function (`module:function`) and of modules, then arguments again and again, and answer each.

    Each link has one call at a time, and they are done beside each other.
    """
    told: queue.SimpleQueue[tuple[Connection, bytes]] = queue.SimpleQueue()
    name, *imports = _received(links[0]).decode().split()
    for link in links:
        threading.Thread(target=_listen, args=(link, told), daemon=True).start()
    module, _, name = name.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    for each in imports:
        import_module(each)
    threads = ThreadPoolExecutor(len(links))
    while True:
        link, packed = told.get()
        # By this thread alone, as it imports: two that import at once see modules that are half done. It comes from
        # the process that started this one.
        given = pickle.loads(packed)  # noqa: S301
        threads.submit(_answer, link, function, given)


def _answer(link: Connection, function: Callable[..., Any], given: tuple[Any, ...]) -> None:
    try:
        answer = None, function(*given)
    # Whoever asked raises it.
    except Exception as error:  # noqa: BLE001
        answer = error, None
    try:
        link.send(answer)
    except BaseException:  # noqa: BLE001
        # Whoever asked would wait for ever.
        traceback.print_exc()
        os._exit(1)


def _listen(link: Connection, told: queue.SimpleQueue[tuple[Connection, bytes]]) -> None:
    while True:
        told.put((link, _received(link)))


def _received(link: Connection) -> bytes:
    try:
        return link.recv_bytes()
    except (EOFError, OSError):
        # The process that started this one has no more for it, or was killed: it must not write beside a restart.
        os._exit(0)
