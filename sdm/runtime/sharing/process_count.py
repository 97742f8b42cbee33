"""Number of processes that share work: it is known without torch and Warp, so that they start while those are read."""

from __future__ import annotations

import os
from pathlib import Path

# Seconds until processes come to their first map: two of `sdm generate` on a host of 32 cores took 7.6. Work that one
# process, which has started, ends within a quarter more is no work for them.
START, WORTH = 8.0, 1.25
# Processes on one GPU, and cores that each is to have: the host's part of the work takes longer than the device's, and
# is held up by Python's lock.
OF_ONE_GPU, CORES = 4, 4
# Where Linux has the devices of its drivers.
DEVICES = Path("/dev")


def processes_for(devices: list[str], seconds: float, *, several: bool = True) -> list[str]:
    """The devices of processes that share work, some of them several times; one alone where it ends before others help.

    Args:
        devices: Of this machine.
        seconds: About how long one process would take.
        several: Whether a GPU has room for more than one of them.
    """
    if not devices[0].startswith("cuda"):
        return devices[:1]
    each = max(1, min(OF_ONE_GPU, cores() // (CORES * len(devices)))) if several else 1
    return devices * each if seconds > WORTH * START else devices[:1]


def cores() -> int:
    """As `sdm.kernels.launch.cores`, which only comes with Warp."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def gpus_expected(wanted: str) -> list[str]:
    """The GPUs that a command will probably work on, by the system's files: torch takes seconds to say so.

    Args:
        wanted: The device as commands take it: auto, cpu, cuda or cuda:N.
    """
    if wanted == "cpu":
        return []
    count = len(list(DEVICES.glob("nvidia[0-9]*")))
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        count = min(count, sum(word.strip() not in ("", "-1") for word in visible.split(",")))
    if wanted == "auto":
        return [f"cuda:{n}" for n in range(count)]
    return [wanted] if count else []
