"""Rates of commands while they work: without the start of processes, which long jobs do not see."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import redirect_stdout, suppress
from pathlib import Path
from typing import Any

from sdm.bench.disk.pipelines import compute, settings_for
from sdm.dataset import generate
from sdm.runtime.pipeline.stage_times import StageTimes

# The part of the items between which the rate is that of work alone.
FIRST, LAST = 0.25, 0.95
# Between two looks at files that grow [s].
PAUSE = 0.05
# Bytes of files that may have got their place beforehand.
LARGE = 1 << 20
# Of a dataset whose rate once it runs is told.
SHARDS = 8


def rates(begin: float, times: list[float], counts: Sequence[float]) -> dict[str, float]:
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


def compute_rates(
    jobs: list[tuple[Path, Path]],
    resolution: int,
    device: str,
    times: StageTimes,
    *,
    processes: list[str] | None = None,
) -> Any:
    """Rates of `sdm compute` on a device, by the times of its files; by these processes, or as it chooses itself."""
    settings, begin = settings_for(resolution, device), time.time()
    # Lines are printed in the order of meshes, and so all of them late where the first one is.
    with redirect_stdout(io.StringIO()):
        compute(jobs, settings, devices=[device], processes=processes, times=times)
    written = sorted(target.stat().st_mtime for _, target in jobs)
    return rates(begin, written, list(range(1, len(written) + 1)))


def command_rates(jobs: list[tuple[Path, Path]], resolution: int, device: str, times: StageTimes) -> dict[str, float]:
    """Rates of `sdm compute` as called from a shell, by the times of its files; of all from its start to its exit.

    All maps go to one folder, and are named like their meshes.
    """
    out, ending = jobs[0][1].parent, "".join(jobs[0][1].suffixes).removeprefix(".")
    report = out.with_name(f"{out.name}-report.json")
    words = ["compute", *(str(source) for source, _ in jobs), "-o", f"{out}/", "--format", ending, "--report", report]
    words += ["--resolution", str(resolution), "--device", device]
    begin = time.time()
    subprocess.run([sys.executable, "-m", "sdm", *words], check=True, stdout=subprocess.DEVNULL)
    seconds = time.time() - begin
    times.hear("command", ({}, json.loads(report.read_text())["seconds_of_stages"]))
    report.unlink()
    written = sorted(target.stat().st_mtime for _, target in jobs)
    return {**rates(begin, written, list(range(1, len(written) + 1))), "of_all": round(len(jobs) / seconds, 3)}


def generate_rates(
    family: Any, grid: Any, count: int, out: Path, times: StageTimes, **options: Any
) -> dict[str, float]:
    """Rates of `sdm generate`, by the bytes of its files as they grow.

    By shards that are finished they would be too high: those of many writers end together.
    """
    stamps: list[float] = []
    written: list[int] = []
    ended = threading.Event()

    def look() -> None:
        while not ended.wait(PAUSE):
            stamps.append(time.perf_counter())
            written.append(bytes_in(out.with_name(f"{out.name}.part")))

    watch = threading.Thread(target=look, daemon=True)
    begin = time.perf_counter()
    watch.start()
    try:
        generate(family, grid, count, out, times=times, **options)
    finally:
        ended.set()
        watch.join()
    last = bytes_in(out)
    # Once it is finished the folder has another name.
    seen = [(at, size) for at, size in zip(stamps, written, strict=True) if size] + [(time.perf_counter(), last)]
    found = rates(begin, [at for at, _ in seen], [count * min(size / last, 1.0) for _, size in seen])
    if len(list((out / "sha256" / "c").glob("*"))) < SHARDS:
        # The speed of one file is not that of the work.
        found.pop("steady", None)
    return found


def bytes_in(folder: Path) -> int:
    """Bytes of the files of a folder, some of which may go meanwhile.

    A file that has got its place on the disk beforehand counts by what is written of it.
    """
    found = 0
    for root, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                found += _written(Path(root, name))
    return found


def _written(path: Path) -> int:
    size = path.stat().st_size
    if size < LARGE or not hasattr(os, "SEEK_HOLE"):
        return size
    handle = os.open(path, os.O_RDONLY)
    try:
        return os.lseek(handle, 0, os.SEEK_HOLE)
    finally:
        os.close(handle)
