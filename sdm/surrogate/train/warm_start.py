"""Warm start of SDMNN+: modes by proper orthogonal decomposition, and a network fitted to their coefficients."""

from __future__ import annotations

import time
from collections.abc import Callable

import torch
from torch import Tensor, nn

from sdm.core.random import generator
from sdm.surrogate.networks.pod_chebyshev import decompose
from sdm.surrogate.networks.sdmnn_plus import SDMNNPlus
from sdm.surrogate.train.map_buffer import Replay
from sdm.training.schedules import warmup_cosine

SNAPSHOTS = 4096
BATCH = 1024
RATE = 2e-3
CHUNK = 64


def warm_start(
    model: SDMNNPlus,
    replay: Replay,
    *,
    seconds: float = 60.0,
    steps: int = 30_000,
    seed: int = 0,
    report: Callable[[str], None] = print,
) -> None:
    """Set the model's mean and modes from stored maps, and train what gives the coefficients.

    Args:
        model: On the store's device.
        replay: Filled with more maps than the model has modes.
        seconds: Most time for the coefficients.
        steps: Most steps for them.
        seed: Of the batches' order.
        report: Is told in one line how well it went.
    """
    with torch.no_grad():
        wanted = _decompose(model, replay, report)
    theta = replay.theta[: replay.count]
    own = [*model.trunk.parameters(), *model.coefficients.parameters()]
    optimizer = torch.optim.Adam(own, RATE, fused=theta.is_cuda)
    random = generator(seed, "surrogate warm start", device=theta.device)
    start = time.perf_counter()

    def guess(part: Tensor) -> Tensor:
        return model.coefficients(model.trunk(model.features(part))) * model.scale

    guess_fast = torch.compile(guess) if theta.is_cuda else guess
    for step in range(steps):
        share = max(step / steps, (time.perf_counter() - start) / seconds)
        if share >= 1:
            break
        for group in optimizer.param_groups:
            group["lr"] = RATE * warmup_cosine(share)
        rows = torch.randint(len(theta), (min(BATCH, len(theta)),), generator=random, device=theta.device)
        # Modes are orthogonal with mean square 1: this is the root mean square error of a coarse voxel [mm].
        loss = (guess_fast(theta[rows]) - wanted[rows]).square().sum(1).mean().sqrt()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(own, 1.0)
        optimizer.step()
        if step % 50 == 0 and theta.is_cuda:
            torch.cuda.synchronize()
    with torch.no_grad():
        left = (guess(theta) - wanted).square().sum(1).mean().sqrt()
    report(f"coefficients: {float(left):.4f} mm root mean square on the maps they were fitted to")


def _decompose(model: SDMNNPlus, replay: Replay, report: Callable[[str], None]) -> Tensor:
    """Coefficients (N,modes) [mm] of all stored maps, after setting mean, modes and scale."""
    maps = torch.cat([model.coarse_of(part.float()) for part in replay.maps[: replay.count].split(CHUNK)])
    mean, modes, _ = decompose(maps[:SNAPSHOTS], model.config["modes"])
    size = maps.shape[1] ** 0.5
    coefficients = torch.cat([(part - mean) @ modes.T for part in maps.split(1024)]) / size
    model.mean.copy_(mean)
    model.modes.copy_(modes * size)
    model.scale.copy_(coefficients.std(0))
    left = [
        (part - mean - (c * size) @ modes).abs().mean()
        for part, c in zip(maps.split(1024), coefficients.split(1024), strict=True)
    ]
    report(f"{len(modes)} modes of {min(len(maps), SNAPSHOTS)} maps leave {float(torch.stack(left).mean()):.4f} mm")
    return coefficients
