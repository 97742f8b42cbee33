"""The host's share of `sdm compute`: its read and write stages alone, by threads.

    python -m sdm.bench.disk.host_stages --out results/disk-host-cpu.json

What a GPU leaves to the host: a mesh is read, its grid and digest are found, its map is written, and the mesh is
looked at. The map is one that is there already, so no device is needed. Tasks that go to the pool of kernels, and waits
of threads, are counts, which what else the machine does changes little; a thread that gives up Python's lock has to
wait for the others to have it back. Milliseconds and counts are those of one mesh, medians of the rounds; `per_second`
is the rate of the whole stage.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import torch
import tyro

from sdm.bench.common import json_file
from sdm.bench.common.machine import describe
from sdm.bench.disk.inputs import write_meshes
from sdm.bench.disk.pipelines import settings_for
from sdm.cli.maps.map_stages import MapStages
from sdm.cli.maps.work import MapTask, Measured
from sdm.kernels import launch
from sdm.runtime.host_copy import HostCopy


@dataclass(frozen=True)
class Options:
    """Both stages over some meshes.

    Args:
        meshes: Read and written in each run.
        triangles: Of each, in a binary PLY file.
        resolution: Voxels along each axis.
        threads: Of the runs.
        rounds: How often everything is done.
        pool: Threads of the pool of kernels, which a GPU's host has.
        folder: Where to write; a temporary one by default.
        out: JSON file.
    """

    meshes: int = 45
    triangles: int = 20_000
    resolution: int = 128
    threads: tuple[int, ...] = (1, 4, 8)
    rounds: int = 3
    pool: int = 15
    folder: Path | None = None
    out: Path | None = None


def rows(options: Options) -> list[dict[str, Any]]:
    """A row for each stage, format and number of threads."""
    os.environ["SDM_NUM_THREADS"] = str(options.pool)
    launch._pool.cache_clear()
    tasks = _count_tasks(launch._pool(os.getpid()))
    found: dict[tuple[Any, ...], list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        files = write_meshes(Path(folder) / "meshes", options.meshes, options.triangles, "ply")
        stages = MapStages(settings_for(options.resolution, "cpu"), lambda share: None)
        values, make = _a_map(stages, MapTask(files[0], Path(folder) / "first.npz"))
        for _ in range(options.rounds):
            for ending in ("npz", "nii.gz"):
                jobs = [MapTask(file, Path(folder) / f"{file.stem}.{ending}") for file in files]
                for threads in options.threads:
                    read, taken = _stage(stages.read, jobs, threads, tasks)
                    ready = [Measured(one, HostCopy(values.clone(), make), None, 0, 0.0) for one in read]
                    written = _stage(stages.write, ready, threads, tasks)[1]
                    for stage, one in (("read", taken), ("write", written)):
                        found.setdefault((stage, ending, threads), []).append(one)
    names = ("stage", "format", "threads")
    return [
        dict(zip(names, key, strict=True)) | {name: round(median(one[name] for one in many), 2) for name in many[0]}
        for key, many in found.items()
    ]


def _a_map(stages: MapStages, task: MapTask) -> tuple[torch.Tensor, Callable[[torch.Tensor], Any]]:
    (found,) = stages.measure([stages.read(task)])
    assert found.map is not None
    return found.map.wait().values, found.map._make


def _stage(
    work: Callable[[Any], Any], items: Sequence[Any], threads: int, tasks: list[int]
) -> tuple[list[Any], dict[str, float]]:
    """Results of a stage, and what it took for each item."""

    def timed(item: Any) -> tuple[Any, float]:
        start = time.perf_counter()
        with launch.by_this_thread():
            return work(item), time.perf_counter() - start

    tasks[0], before, start = 0, resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        made = list(pool.map(timed, items))
    seconds, after, count = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF), len(items)
    return [one for one, _ in made], {
        "cpu_ms": 1e3 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime) / count,
        "busy_ms": 1e3 * sum(busy for _, busy in made) / count,
        "waits": (after.ru_nvcsw - before.ru_nvcsw) / count,
        "pool_tasks": tasks[0] / count,
        "per_second": count / seconds,
    }


def _count_tasks(pool: ThreadPoolExecutor) -> list[int]:
    """The number of tasks that go to a pool from now on, as the one entry of a list."""
    count, plain = [0], pool.submit

    def submit(*given: Any, **more: Any) -> Future[Any]:
        count[0] += 1
        return plain(*given, **more)

    pool.submit = submit  # type: ignore[method-assign]
    return count


def main() -> None:
    """Print a row for each run, and write the record."""
    options = tyro.cli(Options, description=__doc__)
    # Torch's threads would wait for each other by spinning, which a CPU's clock counts.
    torch.set_num_threads(1)
    record = {"machine": describe("cpu"), "load": os.getloadavg()[0], "meshes": options.meshes, "pool": options.pool}
    record |= {"triangles": options.triangles, "resolution": options.resolution, "rows": rows(options)}
    for row in record["rows"]:
        sys.stdout.write(" ".join(f"{key} {value}" for key, value in row.items()) + "\n")
    if options.out is not None:
        json_file.write(options.out, record)


if __name__ == "__main__":
    main()
