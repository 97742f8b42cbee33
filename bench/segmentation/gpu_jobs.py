"""Many small trainings on the GPUs of one machine, until they are done or the time is over.

A job is a dictionary with a `name`. Its log is a line of that name in a file: a job whose line is there is done and is
skipped, so the same command goes on where it was. One process on each device takes jobs from a queue.
"""

from __future__ import annotations

import multiprocessing
import queue
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from sdm.bench.segmentation.log_file import Job, Log, LogFile

# From a job, the device, the folder for unfinished work, what the process keeps between jobs, and the deadline
# (time.monotonic()), to the log; None if the deadline came first.
Work = Callable[[Job, str, Path, dict[str, Any], float], Log | None]
# From a job that is done to one that this makes possible, if any.
Follow = Callable[[Job], Job | None]

# Keys of a job that say where files lie on this machine.
PATHS = ("data", "networks", "cache")
# End of the names of files by which a process says that it does a job.
CLAIM = ".claim"
# The process that fills the list may be slower than those that empty it.
PATIENCE_S = 2.0


def devices(count: int | None) -> list[str]:
    """The GPUs of this machine, at most `count`, else the CPU."""
    found = torch.cuda.device_count()
    return [f"cuda:{i}" for i in range(found if count is None else min(count, found))] or ["cpu"]


def run_jobs(
    jobs: Sequence[Job],
    work: Work,
    logs: LogFile,
    unfinished: Path,
    *,
    budget_s: float,
    on: Sequence[str],
    follow: Follow | None = None,
) -> None:
    """Do the jobs that have no log yet, in order, for at most `budget_s` seconds.

    Args:
        jobs: In order of importance.
        work: A function at a module's top level.
        logs: Where logs go.
        unfinished: Folder of checkpoints.
        budget_s: Seconds from now. A job that the budget cuts short leaves a checkpoint.
        on: Devices; one process each.
        follow: What a process asks once a job's log is written; it does what it is told at once, whether there is a log
            or not, unless another process was told the same. A function at a module's top level, or a `partial` of one.
    """
    unfinished.mkdir(parents=True, exist_ok=True)
    for claim in unfinished.glob(f"*{CLAIM}"):
        claim.unlink()
    deadline = time.monotonic() + budget_s
    known = logs.names()
    left = [job for job in jobs if job["name"] not in known]
    print(f"{len(left)} of {len(jobs)} jobs to do on {', '.join(on)}, at most {budget_s:.0f} s", flush=True)
    if not left:
        return
    if len(on) == 1:
        line: Any = queue.Queue()
        for job in left:
            line.put(job)
        _worker(line, work, logs, unfinished, deadline, on[0], follow)
        return
    context = multiprocessing.get_context("spawn")
    line = context.Queue()
    for job in left:
        line.put(job)
    processes = [
        context.Process(target=_worker, args=(line, work, logs, unfinished, deadline, device, follow)) for device in on
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join()


def _worker(
    line: Any, work: Work, logs: LogFile, unfinished: Path, deadline: float, device: str, follow: Follow | None
) -> None:
    kept: dict[str, Any] = {}
    if device.startswith("cuda"):
        torch.cuda.set_device(device)
        torch.backends.cudnn.benchmark = True
        torch.set_float32_matmul_precision("high")

    def done(job: Job) -> bool:
        begin = time.monotonic()
        try:
            log = work(job, device, unfinished, kept, deadline)
        except Exception:  # noqa: BLE001 - the other jobs go on; this one has no log and is tried again
            print(f"{job['name']} failed on {device}:\n{traceback.format_exc()}", flush=True)
            return False
        if log is None:
            print(f"{job['name']}: cut short on {device}", flush=True)
            return False
        # Where the data lay is of no use to others.
        told = {key: value for key, value in job.items() if key not in PATHS}
        logs.put({"job": told, "seconds": round(time.monotonic() - begin, 1), **log})
        print(f"{job['name']}: {time.monotonic() - begin:.1f} s on {device}: {log.get('summary', '')}", flush=True)
        return True

    while time.monotonic() < deadline:
        try:
            job = line.get(timeout=0.0 if isinstance(line, queue.Queue) else PATIENCE_S)
        except queue.Empty:
            break
        if not done(job) or follow is None or time.monotonic() >= deadline:
            continue
        if (then := follow(job)) is not None and claimed(unfinished, then):
            done(then)


def claimed(unfinished: Path, job: Job) -> bool:
    """True if this process is to do a job that follows others: the first of several that ask is."""
    try:
        (unfinished / f"{job['name']}{CLAIM}").touch(exist_ok=False)
    except FileExistsError:
        return False
    return True
