"""Pool of worker processes: they start in a third of a second, as they import no torch and no Warp."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, NamedTuple, Self

from sdm.errors import SDMError
from sdm.runtime.worker_processes.shared_memory import SharedMemory, packed

# Before anything is imported, the places where this process finds what it imports; none if it was interrupted.
BEGIN = """
import os, sys
from multiprocessing.connection import Connection
links = [Connection(int(number)) for number in sys.argv[1:]]
try:
    sys.path[:] = links[0].recv()
except (EOFError, OSError):
    os._exit(0)
from sdm.runtime.worker_processes.serve import serve
serve(links)
"""
# Libraries of linear algebra start a thread for each core otherwise.
ALONE = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
# Until one that has been told to end is ended [s].
PATIENCE = 5.0


class WorkerError(SDMError):
    """A process that was to do a call is gone, which says nothing about what it was called for."""


class _Worker(NamedTuple):
    process: subprocess.Popen[bytes]
    links: list[Connection]
    idle: list[Connection]


class WorkerProcesses:
    """Processes that do calls of a function; a context manager.

    Args:
        function: Its place, `module:function`. What the module imports is what the start costs.
        count: Of processes.
        calls: That a process does at a time, each in a thread of its own.
        shared: Memory that they are to have: arrays in it are not copied.
        imports: Further modules that calls will need, which the first of them then does not wait for.

    They end with this process, however that ends. An interrupt from the terminal is this process's alone.
    """

    def __init__(
        self,
        function: str,
        count: int,
        *,
        calls: int = 1,
        shared: Sequence[SharedMemory] = (),
        imports: Sequence[str] = (),
    ) -> None:
        self._workers: list[_Worker] = []
        self._idle, self._lock = threading.Semaphore(count * calls), threading.Lock()
        self._shared = shared
        handles = [memory.handle for memory in shared]
        try:
            for _ in range(count):
                worker = _started(handles, calls)
                self._workers.append(worker)
                worker.links[0].send(sys.path)
                worker.links[0].send_bytes(" ".join((function, *imports)).encode())
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def call(self, *given: Any) -> Any:
        """Do a call in the process that has the least to do, and return its value. Safe to use from several threads.

        Raises:
            WorkerError: The process died, whose work nobody else takes.
            Exception: What the function raised.
        """
        with self._idle:
            with self._lock:
                worker = max(self._workers, key=lambda one: len(one.idle))
                link = worker.idle.pop()
            try:
                link.send_bytes(packed(given, self._shared))
                error, value = link.recv()
            except (EOFError, OSError):
                code = worker.process.wait()
                raise WorkerError(f"a worker process died (exit code {code}); --resume goes on from there") from None
            finally:
                with self._lock:
                    worker.idle.append(link)
        if error is not None:
            raise error
        return value

    def close(self) -> None:
        """End them; calls that are still on are cut off."""
        for worker in self._workers:
            for link in worker.links:
                link.close()
        for worker in self._workers:
            try:
                worker.process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                worker.process.kill()
                worker.process.wait()


def _started(handles: Sequence[int], calls: int) -> _Worker:
    with ExitStack() as stack:
        pairs = [socket.socketpair() for _ in range(calls)]
        theirs = [stack.enter_context(pair[1]).fileno() for pair in pairs]
        # Nothing but our own words.
        process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-c", BEGIN, *map(str, theirs)],
            stdin=subprocess.DEVNULL,
            env={**os.environ, **ALONE},
            pass_fds=[*theirs, *handles],
            # Otherwise an interrupt would reach it too.
            process_group=0,
        )
    links = [Connection(ours.detach()) for ours, _ in pairs]
    return _Worker(process, links, [*links])
