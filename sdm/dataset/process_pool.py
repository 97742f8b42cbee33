"""Shards on the devices of one machine: in this process, or in one process for each device."""

from __future__ import annotations

import multiprocessing
import queue
from collections.abc import Callable, Iterator
from typing import Any

from sdm.dataset.shard_job import Job
from sdm.errors import SDMError
from sdm.runtime.pipeline.stage_times import StageTimes

# How often the processes are looked at while they say nothing [s].
PATIENCE = 1.0


def run_here(
    job: Job, shards: list[int], devices: list[str], done: Callable[[int], None], times: StageTimes | None = None
) -> None:
    """Make shards; `done(number)` is called for each that is on the disk.

    `times` is the clock of the stages, where they are in this process.

    Raises:
        SDMError: A process failed or died.
    """
    if len(devices) == 1 or len(shards) == 1:
        job.run(shards, job.maker(devices[0]), done, times=times)
        return
    # A forked process cannot use CUDA.
    context = multiprocessing.get_context("spawn")
    todo: Any = context.Queue()
    said: Any = context.Queue()
    for number in shards:
        todo.put(number)
    for _ in devices:
        todo.put(None)
    workers = [context.Process(target=_serve, args=(job, device, todo, said), daemon=True) for device in devices]
    for worker in workers:
        worker.start()
    try:
        left = len(shards)
        while left:
            number = _hear(said, workers, devices)
            done(number)
            left -= 1
        for worker in workers:
            worker.join()
    finally:
        for worker in workers:
            worker.terminate()
            worker.join()


def _hear(said: Any, workers: list[Any], devices: list[str]) -> int:
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


def _serve(job: Job, device: str, todo: Any, said: Any) -> None:
    def shards() -> Iterator[int]:
        while (number := todo.get()) is not None:
            yield number

    try:
        job.run(shards(), job.maker(device), lambda number: said.put(("done", number)))
    except SDMError as error:
        said.put(("error", str(error)))
