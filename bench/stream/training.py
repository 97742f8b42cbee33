"""A training step fed by the stream against the same step on one batch that stays, on one GPU and on all."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable
from typing import Any

import torch
import torch.distributed as dist
from torch.nn.functional import mse_loss
from torch.nn.parallel import DistributedDataParallel

from sdm.bench.stream.networks import NETWORKS
from sdm.bench.stream.sizes import Bench
from sdm.stream import Batch, SDMStream

# The network of the scaling and of the DataLoader.
USUAL = "u-net"


def training(bench: Bench, *, compiled: bool = False) -> dict[str, Any]:
    """Steps a second of each network; under torchrun of one, first on one GPU while the others wait, then on all."""
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if world == 1:
        return {name: by_turns(bench, name, bench.stream(bench.batch), compiled) for name in NETWORKS}
    return across(bench, world, int(os.environ["RANK"]), compiled)


def compiled(bench: Bench) -> dict[str, Any]:
    """As `training`, the network under torch.compile."""
    return training(bench, compiled=True)


def across(bench: Bench, world: int, rank: int, compiled: bool) -> dict[str, Any]:
    """One process alone, then all; `scaling` is how much of `world` times its samples a second they reach."""
    alone = by_turns(bench, USUAL, bench.stream(bench.batch, rank=0, world_size=1), compiled) if rank == 0 else {}
    dist.barrier()
    together = by_turns(bench, USUAL, bench.stream(bench.batch), compiled, world)
    if rank:
        return {}
    ratio = {
        key: together[f"{key}_samples_per_second"] / (world * alone[f"{key}_samples_per_second"])
        for key in ("streamed", "cached")
    }
    return {"processes": world, "network": USUAL, "alone": alone, "together": together, "scaling": ratio}


def by_turns(bench: Bench, name: str, source: SDMStream, compiled: bool, world: int = 1) -> dict[str, Any]:
    """The two kinds of step take turns, so that a slower minute of the machine counts for both."""
    net = network(bench, name, compiled, world)
    step = make_step(bench, net)
    batches = iter(source)
    cached = next(batches)

    def streamed() -> None:
        step(next(batches))

    def kept() -> None:
        step(cached)

    if bench.gpu:
        torch.cuda.reset_peak_memory_stats()
    bench.calls(streamed, shared=world > 1)
    count = bench.calls(kept, shared=world > 1)
    turns = [(bench.speed(streamed, count), bench.speed(kept, count)) for _ in range(bench.turns)]
    speeds = {"streamed": statistics.median(a for a, _ in turns), "cached": statistics.median(b for _, b in turns)}
    return {
        "parameters": sum(p.numel() for p in net.parameters()),
        "precision": "bfloat16 autocast, channels last" + (", torch.compile" if compiled else ""),
        "batch_per_process": bench.batch,
        "steps_of_a_turn": count,
        "streamed_to_cached": statistics.median(a / b for a, b in turns),
        **{f"{key}_step_ms": 1e3 / value for key, value in speeds.items()},
        **{f"{key}_samples_per_second": world * bench.batch * value for key, value in speeds.items()},
        "turns": [[round(a, 3), round(b, 3)] for a, b in turns],
        "peak_memory_mib": torch.cuda.max_memory_allocated() / 2**20 if bench.gpu else None,
    }


def network(bench: Bench, name: str = USUAL, compiled: bool = False, world: int = 1) -> torch.nn.Module:
    """A network of `sdm.bench.stream.networks`, under DDP if there are several processes."""
    torch.manual_seed(0)
    net = NETWORKS[name](len(bench.family.parameters), bench.resolution).to(bench.device)
    if world > 1:
        net = DistributedDataParallel(net)
    if compiled:
        net.compile(dynamic=False)
    return net


def make_step(bench: Bench, net: torch.nn.Module) -> Callable[[Batch], None]:
    """A step of training: parameters to map, MSE, Adam."""
    optimizer = torch.optim.Adam(net.parameters(), 1e-4, fused=bench.gpu)

    def step(batch: Batch) -> None:
        with torch.autocast(bench.device.split(":")[0], dtype=torch.bfloat16):
            guess = net(batch.theta)
        loss = mse_loss(guess.float(), batch.sdm)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()

    return step
