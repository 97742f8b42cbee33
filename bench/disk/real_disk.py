"""On a real disk: what share of the smaller of disk and engine do `sdm generate` and `sdm compute` reach?

    python -m sdm.bench.disk.real_disk --device cuda --folder /mnt/data

By turns: the command, then files of the sizes that it wrote by plain writers: one after the other, each flushed; the
same by threads; and these past the system's cache. The engine alone makes the same and keeps nothing. Output is removed
after each turn. The share is that of the best of the three writers, or of the engine where that is slower, which the
command reaches between a quarter and nineteen twentieths of its work (`steady`), and `with_start`: of `sdm compute`
from the command's start to its exit, of `sdm generate` from its call on, with kernels that have been loaded before.
Commands choose their processes themselves. If `--processes` says how many measure on the GPU, both are calls.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.checkout import results_folder
from sdm.bench.common.machine import describe
from sdm.bench.disk.devices import MAPS_AT, MESHES_AT, TRIANGLES, meshes_in
from sdm.bench.disk.pipelines import alone_of_compute, alone_of_generate
from sdm.bench.disk.plain_writer import plain_seconds
from sdm.bench.disk.steady import command_rates, compute_rates, generate_rates
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.thread_count import writers_beside
from sdm.shapes import Cochlea

# Ways of plain writers, and bytes of each turn of them at most.
ONE, THREADS, DIRECT = "one after the other", "threads", "threads, direct"
MOST_PLAIN = 4 * 10**9
WORKS = ("generate float16 none", "generate float32 zstd", "compute .npz", "compute .nii.gz")


@dataclass(frozen=True)
class Work:
    """A command's work.

    Args:
        name: As in the record.
        count: Maps, or meshes.
        alone: Seconds of the engine alone.
        run: Does the work into a folder that is there; its rates.
    """

    name: str
    count: int
    alone: float
    run: Callable[[Path, StageTimes], Any]


def works(names: list[str], folder: Path, maps: int, meshes: int, device: str, processes: int) -> list[Work]:
    """The commands of these names, each with one of its formats, in their order."""
    kinds = {name.split()[0] for name in names}
    several: dict[str, Any] = {"processes": [device] * processes} if processes else {"device": device}
    alone: dict[str, float] = {}
    family = Cochlea(TRIANGLES)
    grid, files = family.grid(MAPS_AT), list[Path]()
    if "generate" in kinds:
        alone["generate"] = alone_of_generate(family, grid, maps, device)[0]
    if "compute" in kinds:
        files = meshes_in(folder / "meshes", meshes)
        some = [sdm.load_mesh(file) for file in files[:300]]
        alone["compute"] = alone_of_compute(some, MESHES_AT, device)[0] * meshes / len(some)

    def make(out: Path, times: StageTimes, dtype: str, compression: str) -> Any:
        more: dict[str, Any] = {"dtype": getattr(torch, dtype), "compression": compression, **several}
        return generate_rates(family, grid, maps, out / "d.zarr", times, **more)

    def measure(out: Path, times: StageTimes, ending: str) -> Any:
        jobs = [(file, out / f"{file.stem}{ending}") for file in files]
        if not processes:
            return command_rates(jobs, MESHES_AT, device, times)
        return compute_rates(jobs, MESHES_AT, device, times, processes=several["processes"])

    found = []
    for name in names:
        kind, *how = name.split()
        run: Any = {"generate": make, "compute": measure}[kind]
        count = {"generate": maps, "compute": meshes}[kind]
        found.append(Work(name, count, alone[kind], lambda out, times, run=run, how=how: run(out, times, *how)))
    return found


def row_of(
    work: Work, folder: Path, rounds: int, until: float, device: str, processes: int, most: int
) -> dict[str, Any]:
    """Rates of all turns, and the share of the medians; plain writers write so many bytes at most."""
    threads = writers_beside(torch.device(device))
    ours: list[dict[str, float]] = []
    plain: dict[str, list[float]] = {name: [] for name in (ONE, THREADS, DIRECT)}
    busy: dict[str, float] = {}
    sizes: list[int] = []
    for number in range(rounds):
        if number and time.monotonic() > until:
            break
        out, times = folder / "out", StageTimes()
        out.mkdir()
        os.sync()
        ours.append(work.run(out, times))
        busy = times.seconds
        sizes = [file.stat().st_size for file in sorted(out.rglob("*")) if file.is_file()]
        shutil.rmtree(out)
        # Enough to tell the disk's speed.
        some = sizes[: max(1, len(sizes) * most // max(most, sum(sizes)))]
        share = sum(some) / sum(sizes) * work.count
        for name, writers, direct in ((ONE, 1, False), (THREADS, threads, False), (DIRECT, threads, True)):
            plain[name].append(share / plain_seconds(folder / "plain", some, threads=writers, direct=direct))
    rates = {"of_all": [one["of_all"] for one in ours], "steady": [one.get("steady", one["of_all"]) for one in ours]}
    middle = {name: sorted(found)[len(found) // 2] for name, found in {**rates, **plain}.items()}
    engine = work.count / work.alone
    limit = min(max(middle[name] for name in plain), engine)
    each = sum(sizes) / 1e6 / work.count
    return {
        "work": work.name,
        "count": work.count,
        "processes": processes or "as the command chooses",
        "rounds": len(ours),
        "per_second": round(middle["of_all"], 1),
        "steady_per_second": round(middle["steady"], 1),
        "engine_alone_per_second": round(engine, 1),
        "disk_per_second": {name: round(middle[name], 1) for name in plain},
        "writing_threads": threads,
        "of_one_after_the_other": round(middle["steady"] / min(middle[ONE], engine), 3),
        "of_smaller": round(middle["steady"] / limit, 3),
        "of_smaller_with_start": round(middle["of_all"] / limit, 3),
        "mb_each": round(each, 4),
        "mb_per_s": {name: [round(rate * each, 1) for rate in found] for name, found in {**rates, **plain}.items()},
        "busy_seconds": {stage: round(seconds, 3) for stage, seconds in busy.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--folder", type=Path, help="a place on the disk; by default that of temporary files")
    parser.add_argument("--works", nargs="+", default=list(WORKS), choices=WORKS)
    parser.add_argument("--maps", type=int, default=24_000, help="of generate")
    parser.add_argument("--meshes", type=int, default=2400, help="of compute: several processes share so many")
    parser.add_argument("--plain", type=int, default=MOST_PLAIN, help="bytes of each turn of plain writers at most")
    parser.add_argument("--processes", type=int, default=0, help="that measure on the device")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--budget-s", type=float, default=600.0, help="no round begins later, but the first of each")
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args()
    until = time.monotonic() + options.budget_s
    torch.set_num_threads(1)
    if options.folder:
        options.folder.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix="sdm-disk-", dir=options.folder))
    record: dict[str, Any] = {"machine": describe(options.device), "cores": len(os.sched_getaffinity(0))}
    record |= {"load": os.getloadavg()[0], "file_system": file_system_of(folder), "pipelines": []}
    out = options.out or results_folder() / f"disk-real-{options.device.partition(':')[0]}.json"
    try:
        sizes = options.maps, options.meshes, options.device, options.processes
        for work in works(options.works, folder, *sizes):
            row = row_of(work, folder, options.rounds, until, options.device, options.processes, options.plain)
            record["pipelines"].append(row)
            print(" ".join(f"{key} {value}" for key, value in row.items()), flush=True)
            # What is measured is kept, should the rest be cut off.
            json_file.write(out, record)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(out)


def file_system_of(path: Path) -> str:
    """Type of the file system that a path is on, where the system tells."""
    best, kind = "", "unknown"
    try:
        lines = Path("/proc/mounts").read_text().splitlines()
    except OSError:
        return kind
    for line in lines:
        _, place, found = line.split()[:3]
        inside = str(path.resolve()).startswith(place.rstrip("/") + "/") or place == "/"
        if inside and len(place) >= len(best):
            best, kind = place, found
    return kind


if __name__ == "__main__":
    main()
