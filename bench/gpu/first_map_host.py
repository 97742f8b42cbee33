"""Host's way from the call of a first map on a GPU to the launch of its recording, counted on a CPU.

    python -m sdm.bench.gpu.first_map_host [--triangles 1000] [--calls 200] [--other-ms 10]

What asks a GPU is left out: the launch, streams, events, the current device. Told are the functions of the project that
a call enters before the launch, and microseconds until then: right after another call, and after other work, which
empties the processor's caches, as for somebody who comes with meshes of their own.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
import warnings
from array import array
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from statistics import median
from typing import Any
from unittest import mock

import numpy as np
import torch
from torch import Tensor

import sdm
from sdm.bench.common.meshes import torus
from sdm.bench.dense.host_calls import FirstLaunch, entered
from sdm.engine import api
from sdm.errors import SDMWarning
from sdm.runtime import graphs
from sdm.runtime.graphs import captured_call, graph_cache, memory_pool, replay
from sdm.runtime.operators import is_eager

# The number of a device that there is not, as torch tells it of tensors on a CPU.
NO_GPU = -1
_RIGHT = memoryview(array("i", (0, 0)))
MEMORY = 1 << 40


@dataclass(frozen=True)
class Way:
    """The host's way to the launch.

    Args:
        functions: Of the project, file and name, in the order in which they are entered.
        warm_us: The median after another call.
        cold_us: And after other work.
    """

    functions: list[tuple[str, str]]
    warm_us: float
    cold_us: float


class _Event:
    def record(self, stream: Any) -> None:
        """Nothing is noted."""


class _LastLaunch:
    event, by_default = _Event(), True


class Unlaunched(captured_call.TableRecording):
    """A recording that ends the call where it would be launched."""

    at = 0.0  # seconds, when that was the last time

    def __init__(self, pool: memory_pool.MemoryPool, work: Any, table: captured_call.Table) -> None:
        pool.last = _LastLaunch()  # type: ignore[assignment]
        self.lock, self._pool = threading.Lock(), pool
        self._device, self._index = table.device, NO_GPU
        self._default = mock.Mock(cuda_stream=0)
        self._guesses, self._count, self._told = True, 2, 0
        self._flags = torch.zeros(captured_call.MOST_FLAGS, dtype=torch.int32)
        self._said = self._flags.numpy().data
        self._new, self._most_spare = table.new, table.spare
        self._spare = [self._new()]
        self._table = torch.zeros(table.length, dtype=torch.float64)
        self._room = self._table.numpy().data
        self._replay, self._launched = self._end, False

    def _end(self) -> None:
        Unlaunched.at = time.perf_counter()
        # As after a launch that has ended, of a guess that was right.
        self._said[:2] = _RIGHT
        self._spare.append(self._new())
        if self._launched:
            raise FirstLaunch
        # The first call goes on, as what comes before a launch is less for those after one that was served.
        self._launched = True


def _supports(tensor: Tensor) -> bool:
    """`graphs.supports` of a tensor that is taken for one on the current GPU."""
    return is_eager(tensor) and tensor.get_device() == NO_GPU


@contextmanager
def as_on_a_gpu() -> Iterator[None]:
    """First maps take the way that they take on a GPU, to the launch."""
    caches: dict[torch.device, graph_cache.GraphCache] = {}

    def cache_of(device: torch.device) -> graph_cache.GraphCache:
        return caches.setdefault(device, graph_cache.GraphCache(MEMORY, recordings=replay.MOST_OF_MANY))

    with ExitStack() as stack:
        for where, name, instead in (
            (replay, "_caches", caches),
            (replay, "_cache_of", cache_of),
            (replay, "TableRecording", Unlaunched),
            (captured_call, "current_device", lambda: NO_GPU),
            (captured_call, "raw_stream", lambda index: 0),
            (api, "current_device", lambda: NO_GPU),
            (graphs, "supports", _supports),
            (torch.cuda, "current_stream", lambda index=None: mock.Mock(cuda_stream=0)),
            (Tensor, "record_stream", lambda tensor, stream: None),
        ):
            stack.enter_context(mock.patch.object(where, name, instead))
        yield


def new_calls(triangles: int, resolution: int = 64) -> Iterator[Callable[[], object]]:
    """Calls for first maps of meshes in arrays never seen."""
    vertices, faces = torus(triangles)
    grid = sdm.Grid((-1.2,) * 3, (2.4 / (resolution - 1),) * 3, (resolution,) * 3)
    while True:
        mesh = sdm.TriangleMesh(torch.from_numpy(vertices.copy()), torch.from_numpy(faces.copy()), check=False)
        yield lambda mesh=mesh: api._plain_map(mesh, grid, "cuda")


def measured(triangles: int, calls: int, other_ms: float) -> Way:
    """The way of a mesh of about so many triangles, by half of the calls after other work."""
    warm, cold = [], []
    with as_on_a_gpu():
        made = new_calls(triangles)
        with warnings.catch_warnings():
            # Of a map that nobody made.
            warnings.simplefilter("ignore", SDMWarning)
            # The recording is made, and serves a call.
            next(made)()
        functions = entered(next(made))
        # What comes after is the end of a launch that is none.
        functions = functions[: [name for _, name in functions].index(Unlaunched._end.__qualname__)]
        for number in range(calls):
            call = next(made)
            if number % 2:
                _other_work(other_ms)
            (cold if number % 2 else warm).append(_us(call))
    return Way(functions, median(warm), median(cold))


def _us(call: Callable[[], object]) -> float:
    begin = time.perf_counter()
    with suppress(FirstLaunch):
        call()
    # What comes behind is the end of a launch that is none.
    return 1e6 * (Unlaunched.at - begin)


def _other_work(ms: float) -> None:
    """Sorts and texts, as of somebody who reads files."""
    rng, end = np.random.default_rng(0), time.perf_counter() + 1e-3 * ms
    while time.perf_counter() < end:
        rng.random(400_000).sort()
        json.loads(json.dumps({str(number): [number, str(number)] for number in range(2000)}))


def main() -> None:
    """Print the functions, and the microseconds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, default=1000, help="of the mesh")
    parser.add_argument("--calls", type=int, default=200, help="half of them after other work")
    parser.add_argument("--other-ms", type=float, default=10.0, help="milliseconds of that")
    options = parser.parse_args()
    found = measured(options.triangles, options.calls, options.other_ms)
    for _, name in found.functions:
        print(name)
    print(f"{len(found.functions)} functions; {found.warm_us:.0f} us, {found.cold_us:.0f} us after other work")


if __name__ == "__main__":
    main()
