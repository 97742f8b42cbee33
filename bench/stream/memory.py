"""Memory of the device and of the process over 100,000 batches of one stream."""

from __future__ import annotations

import gc
import itertools
import time
from pathlib import Path
from typing import Any

import torch

from sdm.bench.stream.sizes import Bench
from sdm.shapes import Cochlea
from sdm.stream import SDMStream

BATCHES = 100_000
# (triangles, resolution, batch): the first that is through in the time there is.
SIZES = ((2_000, 32, 8), (1_000, 24, 4), (500, 16, 2))
TRIED = 300
# Share of the time left that a size may take by what its first batches say.
SHARE = 0.85


def endurance(bench: Bench) -> dict[str, Any]:
    """Memory after a hundredth of the batches, and after each tenth."""
    total = BATCHES if bench.gpu else 200
    triangles, resolution, size, batches = _choose(bench, total)
    sums = torch.zeros((), device=bench.device)
    marks, done = [], 0
    start = time.perf_counter()
    for batch in itertools.islice(batches, total):
        # What stands for a training step that reads the batch.
        sums += batch.sdm.square().mean()
        done += 1
        if done in (total // 100, *range(total // 10, total + 1, total // 10)):
            marks.append({"batches": done, **memory(bench)})
        if done % 100 == 0 and bench.left < 5:
            break
    bench.wait()
    seconds = time.perf_counter() - start
    if not marks or marks[-1]["batches"] != done:
        marks.append({"batches": done, **memory(bench)})
    return {
        "triangles": triangles,
        "resolution": resolution,
        "batch": size,
        "batches": done,
        "asked": total,
        "seconds": seconds,
        "finite": bool(torch.isfinite(sums)),
        "grown_mib": {key: marks[-1][key] - marks[0][key] for key in marks[0] if key != "batches"},
        "marks": marks,
    }


def _choose(bench: Bench, total: int) -> tuple[int, int, int, Any]:
    sizes = SIZES if bench.gpu else SIZES[-1:]
    for triangles, resolution, size in sizes:
        family = Cochlea(triangles)
        batches = iter(SDMStream(family, family.grid(resolution), size, device=bench.device))
        seconds = _seconds(bench, batches, TRIED if bench.gpu else 3) * total
        if seconds < SHARE * bench.left or (triangles, resolution, size) == sizes[-1]:
            return triangles, resolution, size, batches
    raise AssertionError("the last size is always taken")


def _seconds(bench: Bench, batches: Any, count: int) -> float:
    """Of one batch; as many again come first and do not count."""
    for _ in range(count):
        next(batches)
    bench.wait()
    start = time.perf_counter()
    for _ in range(count):
        next(batches).sdm.square().mean()
    bench.wait()
    return (time.perf_counter() - start) / count


def memory(bench: Bench) -> dict[str, float]:
    """MiB in use now: of the process, by torch on the device, and by everybody on the device."""
    gc.collect()
    bench.wait()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    found = {"host": pages * 4096 / 2**20}
    if bench.gpu:
        free, total = torch.cuda.mem_get_info()
        found |= {
            "allocated": torch.cuda.memory_allocated() / 2**20,
            "reserved": torch.cuda.memory_reserved() / 2**20,
            "device": (total - free) / 2**20,
        }
    return found
