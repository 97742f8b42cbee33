"""Maps computed in the workers of a DataLoader on all CPU cores, as users do today."""

from __future__ import annotations

import functools
import multiprocessing
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from sdm import Grid, TriangleMesh
from sdm.bench.common.meshes import Case
from sdm.bench.peers import CPU_ONLY, Peer
from sdm.bench.peers.warp import StockWarp
from sdm.bench.stream.sizes import Bench
from sdm.bench.stream.training import make_step, network
from sdm.shapes import Family
from sdm.stream import Batch, Uniform

# Longer than this for one map, and a library is out of the running [s].
SLOWEST = 10.0
# Grid that every library is first tried on: it loads, compiles, and leaves the slow ones out.
FIRST = 12
# Seconds of the measurement at least, on a GPU's machine, and the fewest steps.
SECONDS, FEWEST = 12.0, 3


class PeerMaps(Dataset[tuple[Tensor, Tensor]]):
    """Random shapes and their maps, each worker on one core, by a library of `sdm.bench.peers`."""

    def __init__(self, family: Family, grid: Grid, peer: str) -> None:
        self._family, self._grid, self._peer = family, grid, peer

    def __len__(self) -> int:
        return 1 << 40

    def __getitem__(self, item: int) -> tuple[Tensor, Tensor]:
        theta = Uniform().theta(self._family, 0, torch.tensor([item]))
        peer = peer_by_name(self._peer)
        return theta[0], measure(peer, self._family.mesh(theta[0]), self._grid)[None]


def peers() -> list[Peer]:
    """Every other library that computes on a CPU."""
    return [*(make() for make in CPU_ONLY), StockWarp("cpu")]


def peer_by_name(name: str) -> Peer:
    return next(peer for peer in peers() if peer.name == name)


def measure(peer: Peer, mesh: TriangleMesh, grid: Grid) -> Tensor:
    """A new mesh each time, so its structure counts."""
    peer.build(Case("sample", *mesh.numpy(), frozenset()))
    peer.prepare(grid)
    return peer.signed_distance_map(grid).float()


def loader(bench: Bench) -> dict[str, Any]:
    """The loop of `training`, fed by workers that share no core; the samples that they finish in a while count.

    Each worker hands over single samples, which the loop stacks: whole batches would come from 16 workers all at
    once, a minute apart, and the throughput is the same.
    """
    cores = sorted(os.sched_getaffinity(0))
    with without_gpu():
        tried = compare_peers(bench, cores)
        name = min((row for row in tried if row["seconds"] is not None), key=lambda row: row["seconds"])["library"]
        feed = DataLoader(
            PeerMaps(bench.family, bench.grid, name),
            batch_size=None,
            num_workers=len(cores),
            worker_init_fn=functools.partial(stay_on, cores),
            multiprocessing_context="spawn",
        )
        found = iter(feed)
        # Until every worker has started and worked.
        for _ in range(2 * len(cores)):
            next(found)
    step = make_step(bench, network(bench))
    numbers = torch.zeros(bench.batch, dtype=torch.int64)

    def one() -> None:
        parts = [torch.stack(part) for part in zip(*(next(found) for _ in range(bench.batch)), strict=True)]
        theta, maps = (part.pin_memory() if bench.gpu else part for part in parts)
        step(Batch(theta.to(bench.device, non_blocking=True), maps.to(bench.device, non_blocking=True), numbers))

    one()
    bench.wait()
    start, steps = time.perf_counter(), 0
    seconds = min(SECONDS if bench.gpu else 1.0, bench.left / 2)
    while steps < FEWEST or time.perf_counter() - start < seconds:
        one()
        steps += 1
    bench.wait()
    rate = steps / (time.perf_counter() - start)
    return {
        "workers": len(cores),
        "library": name,
        "libraries": tried,
        "steps": steps,
        "steps_per_second": rate,
        "samples_per_second": rate * bench.batch,
    }


def compare_peers(bench: Bench, cores: list[int]) -> list[dict[str, Any]]:
    """Seconds of one map, structure and query, on one core, by every library that is there; and how right it is.

    Raises:
        SystemExit: There is none.
    """
    there = {peer.name: peer.missing() for peer in peers()}
    names = [name for name, why in there.items() if why is None]
    if not names:
        raise SystemExit("no other CPU library is installed: pip install '.[bench]' in a clone")
    exact = bench.stream(1).sample(0).sdm[0, 0].cpu()
    context = multiprocessing.get_context("spawn")
    rows = []
    for begin in range(0, len(names), len(cores)):
        some = names[begin : begin + len(cores)]
        # A process of its own for each, pinned to a core, so that none borrows another's.
        with context.Pool(len(some), maxtasksperchild=1) as pool:
            jobs = [(name, bench.family, bench.grid, core) for name, core in zip(some, cores, strict=False)]
            rows += pool.starmap(_time_peer, jobs, chunksize=1)
    for row in rows:
        found = row.pop("map")
        if found is not None:
            values = torch.from_numpy(found)
            row["largest_difference"] = float((values.abs() - exact.abs()).abs().max())
            row["other_signs"] = int(((values < 0) != (exact < 0)).sum())
    return [*rows, *({"library": n, "seconds": None, "why": why} for n, why in there.items() if why is not None)]


def _time_peer(name: str, family: Family, grid: Grid, core: int) -> dict[str, Any]:
    stay_on([core], 0)
    peer, mesh = peer_by_name(name), family.mesh(Uniform().theta(family, 0, torch.tensor([0]))[0])
    small = family.grid(FIRST)
    measure(peer, mesh, small)
    begin = time.perf_counter()
    measure(peer, mesh, small)
    guess = (time.perf_counter() - begin) * grid.size / small.size
    if guess > SLOWEST:
        return {"library": name, "seconds": None, "why": f"about {guess:.0f} s for one map", "map": None}
    begin = time.perf_counter()
    values = measure(peer, mesh, grid)
    seconds = time.perf_counter() - begin
    # Not as a tensor, whose memory would go with this process.
    return {"library": name, "seconds": seconds, "note": peer.note, "map": values.numpy()}


def stay_on(cores: list[int], worker: int) -> None:
    """One process, one core: libraries count the cores that they may use, and start as many threads."""
    os.sched_setaffinity(0, {cores[worker % len(cores)]})
    torch.set_num_threads(1)


@contextmanager
def without_gpu() -> Iterator[None]:
    """Processes started here see no GPU: they have nothing to do there, and each would take memory of it."""
    before = os.environ.get("CUDA_VISIBLE_DEVICES")
    os.environ["CUDA_VISIBLE_DEVICES"] = ""
    try:
        yield
    finally:
        if before is None:
            del os.environ["CUDA_VISIBLE_DEVICES"]
        else:
            os.environ["CUDA_VISIBLE_DEVICES"] = before
