"""Rates of commands while they work: without the start of processes, which long jobs do not see."""

from __future__ import annotations

import io
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from sdm.bench.disk.pipelines import compute, settings_for
from sdm.dataset import generate
from sdm.runtime.pipeline.stage_times import StageTimes

# The part of the items between which the rate is that of work alone.
FIRST, LAST = 0.25, 0.95


def rates(begin: float, times: list[float], counts: list[int]) -> dict[str, float]:
    """Items a second of all, and between a quarter and nineteen twentieths of them.

    Args:
        begin: When the work began, in seconds.
        times: Of each sign that some were done.
        counts: How many were, at these times.
    """
    first, last = (next(n for n, count in enumerate(counts) if count >= share * counts[-1]) for share in (FIRST, LAST))
    between = times[last] - times[first]
    found = {"of_all": round(counts[-1] / (times[-1] - begin), 1)}
    # Too few to tell, if all came at once.
    return {**found, "steady": round((counts[last] - counts[first]) / between, 1)} if between > 0 else found


def compute_rates(jobs: list[tuple[Path, Path]], resolution: int, processes: list[str], times: StageTimes) -> Any:
    """Rates of `sdm compute` by processes on these devices, by the times of its files; one alone is this process."""
    settings, begin = settings_for(resolution, processes[0]), time.time()
    # Lines are printed in the order of meshes, and so all of them late where the first one is.
    with redirect_stdout(io.StringIO()):
        compute(jobs, settings, processes=processes, times=times)
    written = sorted(target.stat().st_mtime for _, target in jobs)
    return rates(begin, written, list(range(1, len(written) + 1)))


def generate_rates(
    family: Any, grid: Any, count: int, out: Path, times: StageTimes, **options: Any
) -> dict[str, float]:
    """Rates of `sdm generate`."""
    stamps: list[float] = []
    counts: list[int] = []

    def progress(done: int, total: int) -> None:
        if done:
            stamps.append(time.perf_counter())
            counts.append(done)

    begin = time.perf_counter()
    generate(family, grid, count, out, progress=progress, times=times, **options)
    return rates(begin, stamps, counts)
