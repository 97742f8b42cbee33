"""Shards on the devices of one machine: in this process, and in one more for each device but the first.

Processes take some eight seconds to start, in which this one has done many shards, or imports what it needs itself.
Each has a pipe of its own, and nothing else that two processes use: one that is killed, at whatever moment, leaves no
lock that another waits for.
"""

from __future__ import annotations

import multiprocessing
import pickle
import queue
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self

from sdm.errors import SDMError
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.job import SharedJob
from sdm.runtime.sharing.serve import serve

# Until a process that has let go of its pipe is seen to have ended, and between two looks for an interrupt [s].
PATIENCE, LOOK = 5.0, 1.0


def run_here(
    job: SharedJob,
    shards: list[int],
    devices: list[str],
    done: Callable[[Any], None],
    times: StageTimes | None = None,
    *,
    others: OtherProcesses | None = None,
) -> None:
    """Do shards; `done` is called with what the job tells of each that is on the disk, in whatever order they end.

    Args:
        job: The work.
        shards: Their numbers.
        devices: One process for each; the first one is this.
        done: Called with what is told of a shard.
        times: The clock of the stages in this process.
        others: Processes that have been started already; whoever started them ends them.

    Raises:
        SDMError: A process failed or died.
    """
    if len(devices) == 1 or len(shards) == 1:
        job.run(shards, job.maker(devices[0]), done, times=times)
        return
    todo, left = deque(shards), len(shards)

    def count(told: Any) -> None:
        nonlocal left
        left -= 1
        done(told)

    with OtherProcesses(type(job).__module__) if others is None else nullcontext(others) as beside:
        beside.start(devices[1:])
        beside.work(job, todo, devices[1:])

        def own() -> Iterator[int]:
            while (number := _next(todo)) is not None:
                # What the others have said meanwhile.
                while (told := beside.hear(wait=False)) is not None:
                    count(told)
                yield number

        job.run(own(), job.maker(devices[0]), count, times=times)
        while left:
            count(beside.hear(wait=True))


class OtherProcesses:
    """Processes that take shards from a list of this one; a context manager, which ends those too that still start.

    Args:
        imports: The module of the job that they will be given, which they import beforehand.
    """

    def __init__(self, imports: str) -> None:
        self._imports = imports
        # Reports of shards, or what went wrong.
        self._said: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._workers: list[tuple[Any, Connection]] = []
        self._threads: list[threading.Thread] = []

    def start(self, devices: Sequence[str]) -> None:
        """Have one process for each of these devices, those that were started before among them."""
        # A forked process cannot use CUDA.
        context = multiprocessing.get_context("spawn")
        missing = devices[len(self._workers) :]
        with _no_interrupt() if missing else nullcontext():
            for device in missing:
                ours, theirs = context.Pipe()
                worker = context.Process(target=serve, args=(theirs, self._imports, device), daemon=True)
                self._workers.append((worker, ours))
                try:
                    worker.start()
                finally:
                    # Its end is seen by this.
                    theirs.close()

    def work(self, job: SharedJob, todo: deque[int], devices: Sequence[str]) -> None:
        """Have them do shards of a job, which `hear` tells of.

        Args:
            job: The work.
            todo: Shards that nobody has begun.
            devices: Of each process. If there are more processes, they are ended.
        """
        self.keep(len(devices))
        for (worker, link), device in zip(self._workers, devices, strict=False):
            given = pickle.dumps((job, device))
            thread = threading.Thread(target=self._attend, args=(worker, device, link, given, todo), daemon=True)
            self._threads.append(thread)
            thread.start()

    def keep(self, count: int) -> None:
        """End all but so many, which would hold memory of their devices."""
        self._end(self._workers[count:])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end(self._workers)
        for thread in self._threads:
            thread.join()
        for _, link in self._workers:
            link.close()

    @staticmethod
    def _end(workers: Sequence[tuple[Any, Connection]]) -> None:
        # Of one that did not start there is nothing to end.
        started = [worker for worker, _ in workers if worker.pid is not None]
        for worker in started:
            worker.terminate()
        for worker in started:
            worker.join()

    def hear(self, *, wait: bool) -> Any:
        """Report of a shard by one of the processes; None if there is none, and it is not waited for.

        Raises:
            SDMError: One of them failed or died.
        """
        while True:
            try:
                # Where a lock that is waited for keeps an interrupt back, as on Windows, it comes after a while.
                found = self._said.get(wait, LOOK)
            except queue.Empty:
                if wait:
                    continue
                return None
            if isinstance(found, SDMError):
                raise found
            return found

    def _attend(self, worker: Any, device: str, link: Connection, given: bytes, todo: deque[int]) -> None:
        """Give a process what it asks for, until it ends."""
        try:
            # Not with its start, which waits until it has imported everything if it is handed more than a pipe
            # holds, as the names of a thousand files are: then one starts after the other.
            link.send_bytes(given)
            while (found := link.recv())[0] != "end":
                kind, what = found
                if kind == "next":
                    link.send(_next(todo))
                else:
                    self._said.put(SDMError(what) if kind == "error" else what)
        except (EOFError, OSError):
            worker.join(PATIENCE)
            self._said.put(
                SDMError(f"the process on {device} died (exit code {worker.exitcode}); --resume goes on from there")
            )


def _next(todo: deque[int]) -> int | None:
    with suppress(IndexError):
        return todo.popleft()
    return None


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Processes that the block starts hear of no interrupt, from the first moment on: it is this process's to take."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing.resource_tracker import ensure_running

    # It comes with the first process, and takes interrupts again when it has started.
    ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
