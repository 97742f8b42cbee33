"""Commands of `sdm generate` whose shards are written in one way or the other, whatever the device."""

from __future__ import annotations

import sys

from sdm.runtime.worker_processes.shared_memory import can_share

BY_PROCESSES = """
import sys
from sdm.cli import main
from sdm.dataset import shard_job, shard_stage
shard_job.shard_writers = lambda *where, shards, local: shard_stage.process_writers(*where, count=2)
sys.exit(main(sys.argv[1:]))
"""
WAYS = ("threads", "processes") if can_share() else ("threads",)


def words(way: str) -> list[str]:
    """A command line up to the arguments of `sdm generate`."""
    return [sys.executable, *(("-c", BY_PROCESSES) if way == "processes" else ("-m", "sdm")), "generate"]
