"""Numbers of the page about work from disk to disk, by their records."""

from __future__ import annotations

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


def shares_in_pairs(record: dict[str, Any]) -> list[float]:
    """Shares of the engine's speed: the least median by the clock, and by processor time."""
    rows = record["pipelines"]
    return [min(row["of_engine"] for row in rows), min(row["of_engine_cpu"] for row in rows)]
