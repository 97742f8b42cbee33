"""Pool of worker processes: they start in a third of a second, as they import no torch and no Warp."""

from __future__ import annotations

import os
import queue
import socket
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, NamedTuple, Self

from sdm.errors import SDMError
from sdm.runtime.worker_processes.shared_memory import SharedMemory, packed

# Before anything is imported, the places where this process finds what it imports.
BEGIN = """
import sys
from multiprocessing.connection import Connection
link = Connection(int(sys.argv[1]))
sys.path[:] = link.recv()
from sdm.runtime.worker_processes.serve import serve
serve(link)
"""
# Libraries of linear algebra start a thread for each core otherwise.
ALONE = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
# Until one that has been told to end is ended [s].
PATIENCE = 5.0


class WorkerError(SDMError):
    """A process that was to do a call is gone, which says nothing about what it was called for."""


class _Worker(NamedTuple):
    process: subprocess.Popen[bytes]
    link: Connection


class WorkerProcesses:
    """Processes that do calls of a function, each one call at a time; a context manager.

    Args:
        function: Its place, `module:function`. What the module imports is what the start costs.
        count: Of processes.
        shared: Memory that they are to have: arrays in it are not copied.

    They end with this process, however that ends. An interrupt from the terminal is this process's alone.
    """

    def __init__(self, function: str, count: int, *, shared: Sequence[SharedMemory] = ()) -> None:
        self._workers: list[_Worker] = []
        self._idle: queue.LifoQueue[_Worker] = queue.LifoQueue()
        self._shared = shared
        handles = [memory.handle for memory in shared]
        try:
            for _ in range(count):
                worker = _started(handles)
                self._workers.append(worker)
                worker.link.send(sys.path)
                worker.link.send_bytes(function.encode())
                self._idle.put(worker)
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
        """Do a call in the next process that is idle, and return its value. Safe to use from several threads.

        Raises:
            WorkerError: The process died, whose work nobody else takes.
            Exception: What the function raised.
        """
        worker = self._idle.get()
        try:
            worker.link.send_bytes(packed(given, self._shared))
            error, value = worker.link.recv()
        except (EOFError, OSError):
            code = worker.process.wait()
            raise WorkerError(f"a worker process died (exit code {code}); --resume goes on from there") from None
        finally:
            self._idle.put(worker)
        if error is not None:
            raise error
        return value

    def close(self) -> None:
        """End them; calls that are still on are cut off."""
        for worker in self._workers:
            worker.link.close()
        for worker in self._workers:
            try:
                worker.process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                worker.process.kill()
                worker.process.wait()
        self._workers.clear()


def _started(handles: Sequence[int]) -> _Worker:
    ours, theirs = socket.socketpair()
    with theirs:
        # Nothing but our own words.
        process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-c", BEGIN, str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            env={**os.environ, **ALONE},
            pass_fds=[theirs.fileno(), *handles],
            # Otherwise an interrupt would reach it too.
            process_group=0,
        )
    return _Worker(process, Connection(ours.detach()))
