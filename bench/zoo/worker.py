"""A process that tries one file after the other, and is ended if one takes too long or takes it down."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any


class Worker:
    """Calls of a function in a process of its own.

    Args:
        function: Importable, and so are its arguments.
        limit_s: Seconds after which a call is given up.
    """

    def __init__(self, function: Callable[..., dict[str, Any]], limit_s: float) -> None:
        self._function, self._limit_s = function, limit_s
        self._process: Any = None
        self._pipe: Connection | None = None

    def __call__(self, *inputs: Any) -> dict[str, Any] | str:
        """The function's result, or a sentence that says how the call went wrong."""
        context = multiprocessing.get_context("spawn")
        if self._process is None:
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(self._function, theirs), daemon=True)
            self._process.start()
            theirs.close()
        assert self._pipe is not None
        self._pipe.send(inputs)
        try:
            if self._pipe.poll(self._limit_s):
                return self._pipe.recv()
        except EOFError:
            self._process.join()
            code, self._process = self._process.exitcode, None
            return f"the process ended with code {code}"
        self.close()
        return f"took more than {self._limit_s:g} s"

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None


def _serve(function: Callable[..., dict[str, Any]], pipe: Connection) -> None:
    while True:
        try:
            inputs = pipe.recv()
        except EOFError:
            return
        pipe.send(function(*inputs))
