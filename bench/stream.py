"""The stream: how fast it makes samples, what it costs a training step, and what the usual ways cost.

    python -m bench.stream [--parts rates training loader reading endurance] [--out bench/results/stream.json]

- `rates`: maps a second for the cochlea at 64^3 with 20,000 triangles, in batches of 1, 16 and 64; and for each batch
  the milliseconds of making vertices, building the hierarchy, and querying the grid.
- `training`: a step of a network of SDMNN's size (batch 16, 64^3, bf16 on a GPU) fed by the stream, against the same
  step on one batch that stays.
- `loader`: the same loop fed by a DataLoader whose workers compute the maps on all CPU cores with another library.
- `reading`: samples a second from a dataset on disk, in a DataLoader, against the stream.
- `endurance`: memory over 100,000 batches; not among the parts that run unless it is named.

Under torchrun `training` runs on every GPU under DDP and rank 0 writes the speed of all together.
Answers are checked before they are timed. On a CPU the sizes are small: that only shows that the program runs.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import mse_loss
from torch.nn.parallel import DistributedDataParallel
from torch.utils.data import DataLoader

from bench._checks import compare
from bench._loader import PeerMaps, best_peer
from bench._machine import describe
from bench._networks import Decoder
from bench._stream_sizes import Bench
from bench._timing import median
from bench.brute import Brute
from bench.meshes import Case
from sdm import signed_distance_maps
from sdm.dataset import SDMDataset, generate
from sdm.hierarchy import build
from sdm.shapes import Cochlea
from sdm.stream import Batch, SDMStream
from sdm.topology import boundary_edges

PARTS = ("rates", "training", "loader", "reading")
BATCHES = (1, 16, 64)
ENDURANCE = 100_000
# Voxels of each map that are checked.
CHECKED = 2_000


def rates(bench: Bench) -> dict[str, Any]:
    """Maps a second, and where a batch's time goes."""
    result: dict[str, Any] = {"triangles": len(bench.family.faces), "resolution": bench.resolution, "batches": []}
    check(bench)
    faces = bench.family.faces_on(bench.device)
    for size in BATCHES if bench.gpu else (1, 4):
        theta = bench.family.sample(size, device=bench.device)
        vertices = bench.family.vertices(theta)
        edges = boundary_edges(vertices, faces)
        whole = median(lambda v=vertices: signed_distance_maps(v, faces, bench.grid), bench.device, 20)
        built = median(lambda v=vertices, e=edges: build(v, faces, e), bench.device, 20)
        made = median(lambda t=theta: bench.family.vertices(t), bench.device, 20)
        rate = statistics.median(
            bench.rate(iter(bench.stream(size)), size, bench.steps * (8 if size == 1 else 2)) for _ in range(3)
        )
        result["batches"].append(
            {
                "batch": size,
                "maps_per_second": rate,
                "ms": {"vertices": made.ms, "build": built.ms, "query": whole.ms - built.ms, "maps": whole.ms},
            }
        )
    return result


def check(bench: Bench) -> None:
    """The stream's maps against every triangle in float64, distance and sign, at some voxels."""
    batch = bench.stream(2).sample([0, 1])
    points = bench.grid.points().reshape(-1, 3)
    some = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))[:CHECKED]
    at = points[some].numpy()
    faces = bench.family.faces.numpy()
    for vertices, values in zip(bench.family.vertices(batch.theta).cpu().numpy(), batch.sdm.cpu(), strict=True):
        brute = Brute(vertices, faces, bench.device)
        case = Case("cochlea", vertices, faces, frozenset())
        tally = compare(case, at, values.reshape(-1)[some].numpy(), brute.distance(at)[0], brute.winding_number(at))
        if not tally.fine:
            raise SystemExit(f"the stream is wrong, so nothing was timed: {tally}")


def training(bench: Bench) -> dict[str, Any]:
    """Steps a second fed by the stream and by one batch that stays, by turns."""
    world = int(os.environ.get("WORLD_SIZE", "1"))
    step = make_step(bench, world)
    batches = iter(bench.stream(bench.batch))
    cached = next(batches)
    for _ in range(bench.steps):
        step(next(batches))
        step(cached)
    pairs = []
    for _ in range(bench.turns):
        streamed = bench.speed(lambda: step(next(batches)))
        kept = bench.speed(lambda: step(cached))
        pairs.append((streamed, kept))
    ratio = statistics.median(a / b for a, b in pairs)
    return {
        "gpus": world if bench.gpu else 0,
        "batch": bench.batch,
        "streamed_steps_per_second": statistics.median(a for a, _ in pairs),
        "cached_steps_per_second": statistics.median(b for _, b in pairs),
        "streamed_to_cached": ratio,
        "samples_per_second": world * bench.batch * statistics.median(a for a, _ in pairs),
        "turns": [[round(a, 3), round(b, 3)] for a, b in pairs],
        "peak_memory_mib": torch.cuda.max_memory_allocated() / 2**20 if bench.gpu else None,
    }


def make_step(bench: Bench, world: int = 1) -> Callable[[Batch], None]:
    """A step of training: parameters to map, MSE, Adam."""
    torch.manual_seed(0)
    net: torch.nn.Module = Decoder(len(bench.family.parameters), bench.resolution).to(bench.device)
    if world > 1:
        net = DistributedDataParallel(net)
    optimizer = torch.optim.Adam(net.parameters(), 1e-4, fused=bench.gpu)

    def step(batch: Batch) -> None:
        with torch.autocast(bench.device.split(":")[0], dtype=torch.bfloat16):
            guess = net(batch.theta)
        loss = mse_loss(guess.float(), batch.sdm)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()

    return step


def loader(bench: Bench) -> dict[str, Any]:
    """The same loop fed by a DataLoader that computes the maps on CPU cores, with the fastest library there."""
    cores = len(os.sched_getaffinity(0))
    peer, seconds = best_peer(bench.family, bench.grid)
    source = PeerMaps(bench.family, bench.grid, peer)
    feed = DataLoader(source, bench.batch, num_workers=cores, pin_memory=bench.gpu, multiprocessing_context="spawn")
    step = make_step(bench)
    found = iter(feed)

    def one() -> None:
        theta, maps = next(found)
        numbers = torch.zeros(len(theta), dtype=torch.int64)
        step(Batch(theta.to(bench.device, non_blocking=True), maps.to(bench.device, non_blocking=True), numbers))

    for _ in range(2 * cores // bench.batch + 2):
        one()
    bench.wait()
    start, steps = time.perf_counter(), 0
    while steps < bench.steps and (time.perf_counter() - start < 60 or steps < 3):
        one()
        steps += 1
    bench.wait()
    rate = steps / (time.perf_counter() - start)
    return {
        "workers": cores,
        "library": peer,
        "seconds_of_one_map_on_one_core": seconds,
        "steps_per_second": rate,
        "samples_per_second": rate * bench.batch,
    }


def reading(bench: Bench) -> dict[str, Any]:
    """Samples a second from a dataset, shuffled, against the stream."""
    count = 4096 if bench.gpu else 16
    workers = min(8, len(os.sched_getaffinity(0)))
    result: dict[str, Any] = {"samples": count, "workers": workers}
    with tempfile.TemporaryDirectory() as folder:
        for compression in ("zstd", "none"):
            start = time.perf_counter()
            path = generate(
                bench.family,
                bench.grid,
                count,
                Path(folder) / f"{compression}.zarr",
                device=bench.device,
                compression=compression,
                shard=256 if bench.gpu else 4,
            )
            written = count / (time.perf_counter() - start)
            feed = DataLoader(
                SDMDataset(path), bench.batch, shuffle=True, num_workers=workers, multiprocessing_context="spawn"
            )
            batches: Iterator[Batch] = iter(feed)
            # Until every worker has started.
            for _ in range(workers):
                next(batches)
            start, read = time.perf_counter(), 0
            for batch in batches:
                read += len(batch.index)
            result[compression] = {
                "written_per_second": written,
                "read_per_second": read / (time.perf_counter() - start),
                "mib_per_sample": sum(f.stat().st_size for f in path.rglob("*") if f.is_file()) / count / 2**20,
            }
    result["streamed_per_second"] = bench.rate(iter(bench.stream(bench.batch)), bench.batch, bench.steps)
    return result


def endurance(bench: Bench) -> dict[str, Any]:
    """Memory of the device and the process, at ten moments of a long run."""
    import resource

    family = Cochlea(2_000)
    total = ENDURANCE if bench.gpu else 200
    batches = iter(SDMStream(family, family.grid(32), 16, device=bench.device))
    sums = torch.zeros((), device=bench.device)
    marks = []
    start = time.perf_counter()
    for number, batch in enumerate(itertools.islice(batches, total), 1):
        sums += keep_busy(batch.sdm)
        if number in (total // 100, *range(total // 10, total + 1, total // 10)):
            bench.wait()
            device = (torch.cuda.memory_allocated(), torch.cuda.memory_reserved()) if bench.gpu else (0, 0)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
            marks.append(
                {
                    "batches": number,
                    "allocated_mib": device[0] / 2**20,
                    "reserved_mib": device[1] / 2**20,
                    "host_peak_mib": peak,
                }
            )
    return {"seconds": time.perf_counter() - start, "marks": marks, "finite": bool(torch.isfinite(sums))}


def keep_busy(maps: Tensor) -> Tensor:
    """What stands for a training step that reads the batch."""
    return maps.square().mean()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=(*PARTS, "endurance"), default=list(PARTS))
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--out", type=Path, default=Path("bench/results/stream.json"))
    options = parser.parse_args()
    device, rank = options.device, int(os.environ.get("RANK", "0"))
    if "WORLD_SIZE" in os.environ:
        torch.distributed.init_process_group("nccl" if device.startswith("cuda") else "gloo")
        if device.startswith("cuda"):
            device = f"cuda:{os.environ['LOCAL_RANK']}"
            torch.cuda.set_device(device)
    bench = Bench(device)
    parts: dict[str, Callable[[Bench], dict[str, Any]]] = {
        "rates": rates,
        "training": training,
        "loader": loader,
        "reading": reading,
        "endurance": endurance,
    }
    result: dict[str, Any] = {"machine": describe(device)}
    for name in options.parts:
        result[name] = parts[name](bench)
        if rank == 0:
            print(json.dumps({name: result[name]}, indent=1), flush=True)
            # After each part: a run that is cut off has shown something.
            options.out.parent.mkdir(parents=True, exist_ok=True)
            part = options.out.with_suffix(".part")
            part.write_text(json.dumps(result, indent=1) + "\n")
            part.replace(options.out)
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()


if __name__ == "__main__":
    main()
