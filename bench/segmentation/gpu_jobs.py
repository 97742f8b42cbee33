"""Many small trainings on the GPUs of one machine, until they are done or the time is over.

A job is a dictionary with a `name`. Its result is a JSON file of that name in a folder: a job whose file is there is
done and is skipped, so the same command goes on where it was. One process on each device takes jobs from a list.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import queue
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from sdm.bench.common.json_file import put

Job = dict[str, Any]
# From a job, the device, the folder for unfinished work, what the process keeps between jobs, and the deadline
# (time.monotonic()), to the log; None if the deadline came first.
Work = Callable[[Job, str, Path, dict[str, Any], float], dict[str, Any] | None]
# From a job that is done to one that this makes possible, if any.
Follow = Callable[[Job], Job | None]

# Keys of a job that say where files lie on this machine.
PLACES = ("data", "networks")
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
    logs: Path,
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
        logs: Folder of the JSON files.
        unfinished: Folder of checkpoints.
        budget_s: Seconds from now. A job that the budget cuts short leaves a checkpoint.
        on: Devices; one process each.
        follow: What a process asks once a job's log is written; it does what it is told at once, whether there is a log
            or not, unless another process was told the same. A function at a module's top level, or a `partial` of one.
    """
    logs.mkdir(parents=True, exist_ok=True)
    unfinished.mkdir(parents=True, exist_ok=True)
    for claim in unfinished.glob(f"*{CLAIM}"):
        claim.unlink()
    deadline = time.monotonic() + budget_s
    left = [job for job in jobs if not _log(logs, job).is_file()]
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
    line: Any, work: Work, logs: Path, unfinished: Path, deadline: float, device: str, follow: Follow | None
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
        told = {key: value for key, value in job.items() if key not in PLACES}
        write_log(_log(logs, job), {"job": told, "seconds": round(time.monotonic() - begin, 1), **log})
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
    """Whether a job that follows others is for this process to do: of several that ask, the first."""
    try:
        (unfinished / f"{job['name']}{CLAIM}").touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def write_log(path: Path, log: dict[str, Any]) -> None:
    """Small JSON: numbers of five digits, infinities as words, whole or not at all."""
    put(path, json.dumps(short(log), indent=1, allow_nan=False) + "\n")


def read_logs(folder: Path) -> list[dict[str, Any]]:
    """The logs of a folder's trainings, by name."""
    return [log for log in _logs(folder) if not _of_several(log)]


def read_ensembles(folder: Path) -> list[dict[str, Any]]:
    """The logs of a folder's ensembles, by name: their jobs have `seeds` in place of one."""
    return [log for log in _logs(folder) if _of_several(log)]


def groups_of(job: Job) -> list[Job]:
    """What an ensemble averages: its own networks, then those of other protocols beside them; each `settings`, `seeds`.

    A training is one such group.
    """
    return [job, *job.get("beside", [])]


def is_mixed(log: dict[str, Any]) -> bool:
    """Whether a log is of an ensemble over networks of more than one protocol."""
    return len(groups_of(log["job"])) > 1


def _logs(folder: Path) -> list[dict[str, Any]]:
    return [_long(json.loads(path.read_text())) for path in sorted(folder.glob("*.json"))]


def _of_several(log: dict[str, Any]) -> bool:
    return "seeds" in log["job"]


def _log(logs: Path, job: Job) -> Path:
    return logs / f"{job['name']}.json"


def short(value: Any) -> Any:
    """As a log holds it."""
    if isinstance(value, dict):
        return {key: short(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [short(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else str(value)
    return value


def _long(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _long(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_long(item) for item in value]
    return float(value) if value in ("inf", "-inf", "nan") else value
