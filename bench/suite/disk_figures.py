"""Numbers of the page about work from disk to disk, by their records."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    """Shares of the speed of a plain writer, file after file, and of the best one, of each work."""
    rows = record["pipelines"]
    return [row[key] for key in ("of_one_after_the_other", "of_smaller") for row in rows]


def shares_in_pairs(record: dict[str, Any]) -> list[float]:
    """Shares of the engine's speed: the least median by the clock, and by processor time."""
    rows = record["pipelines"]
    return [min(row["of_engine"] for row in rows), min(row["of_engine_cpu"] for row in rows)]


def by_devices(record: dict[str, Any]) -> list[float]:
    """Of a dataset by two GPUs and one: maps a second once they run, and thousands of maps and seconds of all."""
    one, two = (row for row in record["rows"] if row["work"].startswith("generate"))
    return [two["steady"], one["steady"], one["count"], *(row["count"] / row["of_all"] for row in (two, one))]


def starts(record: dict[str, Any]) -> list[float]:
    """Of maps of meshes: how many, and seconds by one process, and by two, four and eight new ones."""
    rows = sorted((len(row["processes"]), row) for row in record["rows"] if row["work"].startswith("compute"))
    return [rows[0][1]["count"], *(row["count"] / row["of_all"] for _, row in rows)]


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
        (
            "{:.2f} (float16) and {:.2f} (zstd) times the speed of one plain writer, once its processes have started; "
            "{:.2f} and {:.2f} of the best"
        ),
        "disk-real-cuda",
        shares_of_a_disk,
    ),
    ("zstd takes {:.2f} MB of its 1.05", "disk-shards-cpu", bytes_of_a_map),
    (
        (
            "wrote {:,.0f} maps a second by both, where one GPU wrote {:,.0f}, once the processes ran; with their "
            "start {:,.0f} maps took {:.0f} s and {:.0f} s"
        ),
        "disk-devices-cuda",
        by_devices,
    ),
    (
        (
            "{:,.0f} meshes at 128^3 took one process that ran already {:.0f} s, and two, four and eight new ones "
            "{:.0f}, {:.0f} and {:.0f} s"
        ),
        "disk-devices-cuda",
        starts,
    ),
    ("took {:.0f} s, and {:.0f} s in the simulation", "disk-many-cpu", many_files),
    ("of the readers, {:.0f} MB/s (STL) to {:.0f} (PLY)", "disk-readers-cpu", readers),
    ("500,000 samples of {:.0f} meshes a second", "disk-sample-cuda", rates),
    ("at least {:.2f} of the engine's speed, {:.2f} by processor time", "disk-pairs-cpu", shares_in_pairs),
)
