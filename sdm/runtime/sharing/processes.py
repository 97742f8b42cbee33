"""Shards on the devices of one machine: in this process, or in one process for each device."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

import torch

from sdm.errors import SDMError
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.job import SharedJob

# How often the processes are looked at while they say nothing [s].
PATIENCE = 1.0


def run_here(
    job: SharedJob, shards: list[int], devices: list[str], done: Callable[[Any], None], times: StageTimes | None = None
) -> None:
    """Do shards; `done` is called with what the job tells of each that is on the disk, in whatever order they end.

    `times` is the clock of the stages, where they are in this process.

    Raises:
        SDMError: A process failed or died.
    """
    if len(devices) == 1 or len(shards) == 1:
        job.run(shards, job.maker(devices[0]), done, times=times)
        return
    # A forked process cannot use CUDA.
    context = multiprocessing.get_context("spawn")
    before = set(threading.enumerate())
    todo: Any = context.Queue()
    said: Any = context.Queue()
    jobs: Any = context.Queue()
    # This process ends also if one that died has left something in the queues.
    for waiting in (todo, jobs):
        waiting.cancel_join_thread()
    # Not with the start of a process, which waits until the new one has imported everything if it is handed more than a
    # pipe holds, as the names of a thousand files are: then one starts after the other.
    packed = pickle.dumps(job)
    for _ in devices:
        jobs.put(packed)
    for number in shards:
        todo.put(number)
    for _ in devices:
        todo.put(None)
    workers = [context.Process(target=_serve, args=(device, jobs, todo, said), daemon=True) for device in devices]
    for worker in workers:
        worker.start()
    try:
        left = len(shards)
        while left:
            done(_hear(said, workers, devices))
            left -= 1
        for worker in workers:
            worker.join()
    finally:
        for worker in workers:
            worker.terminate()
            worker.join()
        _let_go([todo, jobs], before)


def _hear(said: Any, workers: list[Any], devices: list[str]) -> Any:
    while True:
        for worker, device in zip(workers, devices, strict=True):
            if worker.exitcode not in (None, 0):
                raise SDMError(
                    f"the process on {device} died (exit code {worker.exitcode}); --resume goes on from there"
                )
        try:
            kind, what = said.get(timeout=PATIENCE)
        except queue.Empty:
            continue
        if kind == "error":
            raise SDMError(what)
        return what


def _let_go(queues: list[Any], before: set[threading.Thread]) -> None:
    """Close queues, and wait for the threads behind them, which were not there before.

    Such a thread drops its queue's locks as it ends. At the end of Python it may be stopped in the middle of that, and
    Python warns of a lock that is gone.
    """
    for ended in queues:
        ended.close()
    for thread in set(threading.enumerate()) - before:
        if thread.name == "QueueFeederThread":
            # One whose processes died may wait for a reader for ever.
            thread.join(PATIENCE)


def _serve(device: str, jobs: Any, todo: Any, said: Any) -> None:
    # An interrupt is the first process's to take, which ends this one; and it must not work on if that was killed.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Beside others it has not all cores.
    torch.set_num_threads(1)
    # Locks that libraries make have a name on the system otherwise, of which Python warns once this process is ended.
    if "fork" in multiprocessing.get_all_start_methods():
        multiprocessing.set_start_method("fork", force=True)
    threading.Thread(target=_end_with_parent, daemon=True).start()

    def shards() -> Iterator[int]:
        while (number := todo.get()) is not None:
            yield number

    try:
        # From the process that started this one.
        job: SharedJob = pickle.loads(jobs.get())  # noqa: S301
        job.run(shards(), job.maker(device), lambda told: said.put(("done", told)))
    except SDMError as error:
        said.put(("error", str(error)))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
