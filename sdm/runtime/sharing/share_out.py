"""Shards shared out among devices of this machine, or of a Ray cluster; answers come in the order of the shards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sdm.kernels.launch import cores
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.folder_job import ShardTold
from sdm.runtime.sharing.in_order import InOrder
from sdm.runtime.sharing.job import SharedJob
from sdm.runtime.sharing.processes import run_here
from sdm.runtime.sharing.ray_cluster import run_on_ray

# Items of a shard, so that a device has whole calls, and so few that what a lost worker had in hand is little. Each
# device gets several shards, as some take longer.
LEAST, MOST, OF_EACH = 8, 64, 8
# How many devices a cluster is taken to have, about which nobody can say beforehand.
OF_CLUSTER = 8
# Seconds until processes come to their first map: two of `sdm generate` on a host of 32 cores took 7.6. Work that one
# process, which has started, ends within a quarter more is no work for them.
START, WORTH = 8.0, 1.25
# Processes on one GPU, and cores that each is to have: the host's part of the work takes longer than the device's, and
# is held up by Python's lock.
OF_ONE_GPU, CORES = 4, 4


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


def shard_size(items: int, devices: int) -> int:
    """Items of a shard, a multiple of `LEAST`; 0 devices are those of a cluster."""
    even = items // (OF_EACH * (devices or OF_CLUSTER))
    return max(LEAST, min(MOST, even // LEAST * LEAST))


def share_out(
    job: SharedJob,
    shards: list[int],
    devices: list[str],
    ray: str | None,
    hear: Callable[[list[Any]], None],
    times: StageTimes,
) -> None:
    """Do shards of a job that tells of each by a `ShardTold`.

    Args:
        job: The work.
        shards: Their numbers, in order.
        devices: Of this machine, one process each.
        ray: Address of a Ray cluster in place of them.
        hear: Called with what is told of the items of each shard, in the order of shards.
        times: The clock that hears those of the processes.

    Raises:
        SDMError: A process or the cluster cannot go on.
    """
    if not shards:
        return
    in_order = InOrder(shards, hear)

    def done(told: ShardTold) -> None:
        times.hear(told.process, told.times)
        in_order(told)

    if ray is not None:
        run_on_ray(job, shards, ray, done)
    else:
        run_here(job, shards, devices, done)
