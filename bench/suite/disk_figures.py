"""Numbers of the page about work from disk to disk, by their records."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from sdm.bench.disk.simulate import OBJAVERSE, from_record

JOB = f"hours_of_{OBJAVERSE}_on_8"


def rates(record: dict[str, Any]) -> list[float]:
    """Items a second of each work."""
    return [row["per_second"] for row in record["pipelines"]]


def simulated(record: dict[str, Any]) -> list[float]:
    """Maps a second by the simulation, those measured, and hours of the large job: of .npz, then of .nii.gz."""
    found = []
    for row in record["pipelines"]:
        by_queues = from_record(record, row["work"])
        found += [by_queues["simulated_per_second"]["100000"], row["per_second"], by_queues[JOB]]
    return found


def many_files(record: dict[str, Any]) -> list[float]:
    """Seconds of a run over many files, and of its simulation."""
    return [record["measured_seconds"], record["simulated_seconds"]]


def readers(record: dict[str, Any]) -> list[float]:
    """MB/s of the slowest and the fastest of our own readers."""
    own = [row["mb_per_s"] for row in record["readers"] if row["reader"] == "sdm"]
    return [min(own), max(own)]


def shares_of_a_disk(record: dict[str, Any]) -> list[float]:
    """Shares of the best plain writer's speed, or of the engine's: of datasets, then of maps of meshes."""
    shares = {row["work"]: row["of_smaller"] for row in record["pipelines"]}
    return [
        shares[work] for work in ("generate float16 none", "generate float32 zstd", "compute .npz", "compute .nii.gz")
    ]


def shares_in_pairs(record: dict[str, Any]) -> list[float]:
    """Shares of the engine's speed: the least median by the clock, and by processor time."""
    rows = record["pipelines"]
    return [min(row["of_engine"] for row in rows), min(row["of_engine_cpu"] for row in rows)]


def by_processes(record: dict[str, Any], work: str, ways: Sequence[str]) -> list[float]:
    """Items a second once processes run, of one process, of several on one GPU, and of one on each."""
    found = {way: row["steady"] for way, row in _ways(record, work)}
    return [found[way] for way in ways]


def seconds_by_processes(record: dict[str, Any], work: str, ways: Sequence[str]) -> list[float]:
    """Number of items, and seconds of all, with the start of processes, by each way to share them."""
    found = {way: row["count"] / row["of_all"] for way, row in _ways(record, work)}
    return [record["rows"][0]["count"], *(found[way] for way in ways)]


def _ways(record: dict[str, Any], work: str) -> Iterator[tuple[str, dict[str, Any]]]:
    for row in record["rows"]:
        gpus, processes = len(set(row["processes"])), len(row["processes"])
        if row["work"] == work:
            yield f"{gpus} x {processes // gpus}", row


def bytes_of_a_map(record: dict[str, Any]) -> list[float]:
    """Megabytes of a compressed map."""
    return [next(row["mb_each"] for row in record["rows"] if row["maps"] == "float32 zstd")]


# Words of the page with places for numbers, the record, and what takes them from it.
PHRASES: tuple[tuple[str, str, Callable[[Any], Sequence[Any]]], ...] = (
    (
        "says {:.0f} maps a second as `.npz`, where {:.0f} were measured, and {:.2f} hours",
        "disk-cuda",
        lambda r: simulated(r)[:3],
    ),
    (
        "{:.0f} a second, where {:.0f} were measured, and {:.2f} hours as `.nii.gz`",
        "disk-cuda",
        lambda r: simulated(r)[3:],
    ),
    ("wrote {:.0f} maps of 128^3 a second as `.npz` and {:.0f} as", "disk-cuda", rates),
    (
        "{:.2f} as float16, {:.2f} with zstd, and `sdm compute` {:.2f} as `.npz` and {:.2f} as `.nii.gz`",
        "disk-real-cuda",
        shares_of_a_disk,
    ),
    ("zstd takes {:.2f} MB of its 1.05", "disk-shards-cpu", bytes_of_a_map),
    (
        (
            "{:,.0f} float16 maps took {:.1f} s by one process that ran, {:.1f} s by four, {:.1f} s by one on each GPU "
            "and {:.1f} s by four on each"
        ),
        "disk-devices-cuda",
        lambda r: seconds_by_processes(r, "generate float16 none", ("1 x 1", "1 x 4", "2 x 1", "2 x 4")),
    ),
    (
        "as `.npz`: {:,.0f} a second by one process, {:,.0f} by four, {:,.0f} by one on each GPU",
        "disk-devices-cuda",
        lambda r: by_processes(r, "compute .npz", ("1 x 1", "1 x 4", "2 x 1")),
    ),
    ("took {:.0f} s, and {:.0f} s in the simulation", "disk-many-cpu", many_files),
    ("of the readers, {:.0f} MB/s (STL) to {:.0f} (PLY)", "disk-readers-cpu", readers),
    ("500,000 samples of {:.0f} meshes a second", "disk-sample-cuda", rates),
    ("at least {:.2f} of the engine's speed, {:.2f} by processor time", "disk-pairs-cpu", shares_in_pairs),
)
