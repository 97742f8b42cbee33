"""The stream: how fast it makes samples, what it costs a training step, and what the usual ways cost.

    python -m sdm.bench.stream [--parts rates training loader reading] [--budget-s 150] [--out FILE.json]
    torchrun --nproc-per-node 4 -m sdm.bench.stream --parts training --out bench/results/stream-4.json

- `rates`: maps a second for the cochlea at 64^3 with 20,000 triangles, in batches of 1, 16 and 64; and for each batch
  the milliseconds of making vertices, building the hierarchy, and querying the grid.
- `training`: a step of a network of SDMNN's kind (batch 16, 64^3, bf16 on a GPU) fed by the stream, against the same
  step on one batch that stays. Under torchrun on one GPU alone and then on all under DDP, with the scaling.
- `loader`: the same loop fed by a DataLoader whose workers compute the maps on all CPU cores with the library that is
  fastest there.
- `reading`: samples a second from a dataset on disk, in a DataLoader, against the stream.
- `compiled`: as `training`, the network under torch.compile. Only if named.
- `endurance`: memory over 100,000 batches. Only if named.

Each part is written as soon as it is there, beside the parts that the file has from the same machine and commit.
Answers are checked before they are timed. On a CPU the sizes are small: that only shows that the program runs.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist

from sdm.bench.common.checkout import results_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.stream.loader import loader
from sdm.bench.stream.memory import endurance
from sdm.bench.stream.rates import rates
from sdm.bench.stream.reading import reading
from sdm.bench.stream.sizes import Bench
from sdm.bench.stream.training import compiled, training

PARTS: dict[str, Callable[[Bench], dict[str, Any]]] = {
    "rates": rates,
    "training": training,
    "loader": loader,
    "reading": reading,
    "compiled": compiled,
    "endurance": endurance,
}
USUAL = ("rates", "training", "loader", "reading")
# Those that know what to do with several processes.
SHARED = {"training", "compiled"}
# A part is not begun with less than this left [s]: about what it takes on one H100.
LEAST = {"rates": 15.0, "training": 20.0, "loader": 40.0, "reading": 35.0, "compiled": 60.0, "endurance": 20.0}
PACKAGES = ("warp-lang", "torch", "numpy", "zarr", "libigl")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=tuple(PARTS), default=list(USUAL))
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--budget-s", type=float, help="be through in about this time, leaving out what does not fit")
    parser.add_argument("--out", type=Path, default=results_folder() / "stream.json")
    options = parser.parse_args()
    deadline = None if options.budget_s is None else time.monotonic() + options.budget_s
    several = int(os.environ.get("WORLD_SIZE", "1")) > 1
    if several and not SHARED.issuperset(options.parts):
        parser.error(f"under torchrun only these parts run: {', '.join(sorted(SHARED))}")
    device = join(options.device) if several else options.device
    bench = Bench(device, deadline)
    results = Results(options.out, describe(device, PACKAGES))
    for name in options.parts:
        # Ranks have clocks of their own, and must not disagree.
        if not several and bench.left < LEAST[name]:
            results.leave_out(name, f"{bench.left:.0f} s were left")
            continue
        begin = time.perf_counter()
        found = PARTS[name](bench)
        if not several or dist.get_rank() == 0:
            results.add(name, {**found, "part_seconds": round(time.perf_counter() - begin, 1)})
    if several:
        dist.destroy_process_group()


def join(device: str) -> str:
    """The process group of torchrun; this process's own device."""
    if not device.startswith("cuda"):
        dist.init_process_group("gloo", timeout=timedelta(minutes=10))
        return device
    own = torch.device("cuda", int(os.environ["LOCAL_RANK"]))
    torch.cuda.set_device(own)
    dist.init_process_group("nccl", timeout=timedelta(minutes=10), device_id=own)
    return str(own)


class Results:
    """The file of results: whole at any time, a part of it as soon as that part is there."""

    def __init__(self, path: Path, machine: dict[str, Any]) -> None:
        self._path = path
        self._all: dict[str, Any] = {"machine": machine}
        try:
            before = json.loads(path.read_text())
        except (OSError, ValueError):
            return
        if before.get("machine") == machine:
            self._all = before

    def leave_out(self, name: str, why: str) -> None:
        """Parts that an earlier run has measured are kept."""
        self.add(name, self._all.get(name, {"left_out": why}))

    def add(self, name: str, found: dict[str, Any]) -> None:
        self._all[name] = found
        print(json.dumps({name: found}, indent=1), flush=True)
        write(self._path, self._all)


if __name__ == "__main__":
    main()
