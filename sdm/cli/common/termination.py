"""Termination by a signal, as by `kill` or a scheduler, in the way of an interrupt: nothing half done is left."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Terminated(KeyboardInterrupt):
    """The process was asked to end, by SIGTERM."""


@contextmanager
def raised_termination() -> Iterator[None]:
    """SIGTERM raises `Terminated` in the block, where it would have ended the process at once.

    A library may raise a plain `KeyboardInterrupt` in its place, as Ray does: out of the block comes `Terminated`.
    """
    own, came = os.getpid(), False

    def end(number: int, frame: Any) -> None:
        nonlocal came
        if os.getpid() != own:
            # A fork, which has no more to say than that.
            os._exit(128 + number)
        came = True
        raise Terminated

    # What somebody else has arranged, and what is ignored, stays so.
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, end)
    try:
        yield
    except KeyboardInterrupt as error:
        if came and not isinstance(error, Terminated):
            raise Terminated from error
        raise
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
