"""Shards on the devices of one machine: in this process, and in one more for each device but the first.

Processes take some eight seconds to start, in which this one has done many shards. Each has a pipe of its own, and
nothing else that two processes use: one that is killed, at whatever moment, leaves no lock that another waits for.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import queue
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self

import torch

from sdm.errors import SDMError
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.job import SharedJob

# Until a process that has let go of its pipe is seen to have ended, and between two looks for an interrupt [s].
PATIENCE, LOOK = 5.0, 1.0


def run_here(
    job: SharedJob, shards: list[int], devices: list[str], done: Callable[[Any], None], times: StageTimes | None = None
) -> None:
    """Do shards; `done` is called with what the job tells of each that is on the disk, in whatever order they end.

    `times` is the clock of the stages in this process.

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

    with _Others(job, todo, devices[1:]) as others:

        def own() -> Iterator[int]:
            while (number := _next(todo)) is not None:
                # What the others have said meanwhile.
                while (told := others.hear(wait=False)) is not None:
                    count(told)
                yield number

        job.run(own(), job.maker(devices[0]), count, times=times)
        while left:
            count(others.hear(wait=True))


class _Others:
    """Processes that take shards from the same list; a context manager, which ends those too that are still starting.

    Args:
        job: The work.
        todo: Shards that nobody has begun.
        devices: One process for each.
    """

    def __init__(self, job: SharedJob, todo: deque[int], devices: Sequence[str]) -> None:
        self._job, self._todo, self._devices = pickle.dumps(job), todo, devices
        # Reports of shards, or what went wrong.
        self._said: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._workers: list[Any] = []
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> Self:
        # A forked process cannot use CUDA.
        context = multiprocessing.get_context("spawn")
        try:
            with _no_interrupt():
                for device in self._devices:
                    ours, theirs = context.Pipe()
                    worker = context.Process(target=_serve, args=(device, theirs), daemon=True)
                    self._workers.append(worker)
                    try:
                        worker.start()
                    finally:
                        # Its end is seen by this.
                        theirs.close()
                    thread = threading.Thread(target=self._attend, args=(worker, device, ours), daemon=True)
                    self._threads.append(thread)
                    thread.start()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def _end(self) -> None:
        for worker in self._workers:
            # Of one that did not start there is nothing to end.
            if worker.pid is not None:
                worker.terminate()
        for worker in self._workers:
            if worker.pid is not None:
                worker.join()
        for thread in self._threads:
            thread.join()

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

    def _attend(self, worker: Any, device: str, link: Connection) -> None:
        """Give a process what it asks for, until it ends."""
        with link:
            try:
                # Not with its start, which waits until it has imported everything if it is handed more than a pipe
                # holds, as the names of a thousand files are: then one starts after the other.
                link.send_bytes(self._job)
                while (found := link.recv())[0] != "end":
                    kind, what = found
                    if kind == "next":
                        link.send(_next(self._todo))
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


def _serve(device: str, link: Connection) -> None:
    # An interrupt is the first process's to take, which ends this one; and it must not work on if that was killed.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Beside others it has not all cores.
    torch.set_num_threads(1)
    # Locks that libraries make have a name on the system otherwise, of which Python warns once this process is ended.
    if "fork" in multiprocessing.get_all_start_methods():
        multiprocessing.set_start_method("fork", force=True)
    threading.Thread(target=_end_with_parent, daemon=True).start()

    def shards() -> Iterator[int]:
        while True:
            link.send(("next", None))
            number = link.recv()
            if number is None:
                return
            yield number

    try:
        # From the process that started this one.
        job: SharedJob = pickle.loads(link.recv_bytes())  # noqa: S301
        job.run(shards(), job.maker(device), lambda told: link.send(("done", told)))
    except SDMError as error:
        link.send(("error", str(error)))
    link.send(("end", None))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
