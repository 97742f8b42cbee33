"""Shards shared out among devices of this machine, or of a Ray cluster; answers come in the order of the shards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.folder_job import ShardTold
from sdm.runtime.sharing.in_order import InOrder
from sdm.runtime.sharing.job import SharedJob
from sdm.runtime.sharing.processes import OtherProcesses, run_here
from sdm.runtime.sharing.ray_cluster import run_on_ray

# Items of a shard, so that a device has whole calls, and so few that what a lost worker had in hand is little. Each
# process gets many shards, so that all of them end at about the same time.
LEAST, MOST, OF_EACH = 8, 64, 32
# Shards of a cluster, whose devices nobody can count beforehand; to hand one out takes longer there.
OF_CLUSTER = 64


def shard_size(items: int, devices: int) -> int:
    """Items of a shard, a multiple of `LEAST`; 0 devices are those of a cluster."""
    even = items // (OF_EACH * devices or OF_CLUSTER)
    return max(LEAST, min(MOST, even // LEAST * LEAST))


def share_out(
    job: SharedJob,
    shards: list[int],
    devices: list[str],
    ray: str | None,
    hear: Callable[[list[Any]], None],
    times: StageTimes,
    others: OtherProcesses | None = None,
) -> None:
    """Do shards of a job that tells of each by a `ShardTold`.

    Args:
        job: The work.
        shards: Their numbers, in order.
        devices: Of this machine, one process each.
        ray: Address of a Ray cluster in place of them.
        hear: Called with what is told of the items of each shard, in the order of shards.
        times: The clock that hears those of the processes.
        others: Processes of this machine that have been started already.

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
        run_here(job, shards, devices, done, others=others)
