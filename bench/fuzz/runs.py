"""Many trials: by number, by turns of the parts, in one process or several."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from sdm.bench.fuzz.trial import Finding, Outcome
from sdm.core.random import derive_seed

PARTS = ("numerics", "near_degenerate", "paths", "mesh_files", "map_files", "bands", "datasets", "models")
# Parts that launch kernels.
NUMERIC = {"numerics", "near_degenerate", "paths", "bands"}
# A trial that takes longer hangs, as far as a user is concerned.
MOST_SECONDS = 30.0


class _Hangs(BaseException):
    """End of a trial that hangs. No `Exception`: Warp would keep it as a module's error and raise it ever after."""


@contextmanager
def _ended_if_it_hangs(limited: bool) -> Iterator[None]:
    """End what takes four times as long as is a finding, where a signal can."""
    if not limited or threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: Any) -> None:
        raise _Hangs(f"hangs: not done after {4 * MOST_SECONDS:.0f} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, 4 * MOST_SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def run_trial(part: str, seed: int, number: int, limited: bool = True) -> tuple[Outcome | None, str]:
    """One trial in a folder of its own: its outcome, or the finding's sentence. `limited`: it ends if it hangs."""
    rng = np.random.default_rng(derive_seed(seed, "fuzz", part, number))
    started = np.array([time.monotonic(), time.process_time()])
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), _ended_if_it_hangs(limited):
        warnings.simplefilter("ignore")
        try:
            outcome = importlib.import_module(f"sdm.bench.fuzz.{part}").trial(rng, Path(folder))
        except (Finding, _Hangs) as finding:
            return None, str(finding)
    # By the clock and in work: on a busy machine the clock alone says nothing.
    took = float((np.array([time.monotonic(), time.process_time()]) - started).min())
    return (None, f"{outcome.kind}: took {took:.0f} s") if took > MOST_SECONDS else (outcome, "")


def fuzz(
    parts: Sequence[str], seed: int, minutes: float, first: int = 0, trials: int | None = None, step: int = 1
) -> dict[str, Any]:
    """Run trials of the parts by turns until the time is over; what was tried, refused and found.

    Args:
        parts: Of `PARTS`.
        seed: Of all trials.
        minutes: By the clock.
        first: Number of the first trial.
        trials: Most of each part.
        step: From one trial's number to the next, where several processes share the numbers.
    """
    for part in sorted(NUMERIC & set(parts)):
        # Kernels compile once, which is no trial's fault, however long a busy machine takes.
        run_trial(part, seed, first, limited=False)
    report: dict[str, Any] = {part: {"trials": 0, "refused": 0, "kinds": Counter(), "findings": []} for part in parts}
    stop = time.monotonic() + 60 * minutes
    number = first
    while time.monotonic() < stop and (trials is None or number < first + trials * step):
        for part in parts:
            outcome, sentence = run_trial(part, seed, number)
            row = report[part]
            row["trials"] += 1
            if outcome is None:
                row["findings"].append({"trial": number, "finding": sentence})
                print(f"{part} {number}: {sentence}", file=sys.stderr, flush=True)
            else:
                row["refused"] += outcome.refused
                row["kinds"][outcome.kind] += 1
        number += step
    return report


def fuzz_in_processes(
    processes: int, parts: Sequence[str], seed: int, minutes: float, first: int = 0, trials: int | None = None
) -> dict[str, Any]:
    """`fuzz` in processes of a thread each, which take every `processes`-th trial and the minutes by equal shares."""
    # Read as a process imports its libraries.
    os.environ |= {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "SDM_NUM_THREADS": "1"}
    share = [None if trials is None else len(range(i, trials, processes)) for i in range(processes)]
    jobs = [(parts, seed, minutes / processes, first + i, share[i], processes) for i in range(processes)]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        # A trial of each part here first, so that the others find the kernels compiled.
        for part in sorted(NUMERIC & set(parts)):
            pool.apply(run_trial, (part, seed, first, False))
        reports = pool.starmap(fuzz, jobs, chunksize=1)
    merged = reports[0]
    for report in reports[1:]:
        for part, row in report.items():
            merged[part]["trials"] += row["trials"]
            merged[part]["refused"] += row["refused"]
            merged[part]["kinds"] += row["kinds"]
            merged[part]["findings"] += row["findings"]
    return merged
