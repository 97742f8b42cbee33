"""Host side of a map: functions of the project that a call enters, and microseconds of Python.

    python -m sdm.bench.dense.host_calls [--triangles 2000] [--resolution 64] [--profile]

On a CPU with all launches left out, so that what remains is the host's work. A function counts once however often it is
called; "before" is what comes before the first kernel would be launched. Times are of the calling thread, the
least of many calls.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from types import FrameType
from typing import Any
from unittest import mock

import torch
import warp as wp

import sdm
from sdm.bench.common.meshes import torus
from sdm.engine import ops
from sdm.engine.checks import map_check
from sdm.kernels import launch
from sdm.kernels.launches import compiling, recorded

PACKAGE = Path(sdm.__file__).resolve().parent
# The launch itself is none of the functions before it, nor are those here.
LAUNCH = frozenset((launch.__file__, recorded.__file__, compiling.__file__))


@dataclass(frozen=True)
class Host:
    """The host's work in one call.

    Args:
        functions: Different functions of the project that it enters, comprehensions and generators left out.
        files: Files of the project that these are in.
        us: Microseconds.
    """

    functions: int
    files: int
    us: float


@dataclass(frozen=True)
class Report:
    """A call, up to its first launch and as a whole."""

    before: Host
    whole: Host


class FirstLaunch(Exception):
    """Ends a call where its first kernel would be launched."""


@contextmanager
def without_launches(instead: Callable[..., None] | None = None) -> Iterator[None]:
    """Kernels are prepared and not launched: `instead` is called, on one thread."""
    with (
        # Nor does a GPU's launch ask for the number of threads.
        mock.patch.object(launch, "threads", _one),
        mock.patch.object(wp.Launch, "launch", instead or _nothing),
        mock.patch.object(wp.utils, "radix_sort_pairs", _nothing),
        mock.patch.object(wp.array, "zero_", _nothing),
        # No kernel has written the scales, which the host reads on a CPU.
        mock.patch.object(ops, "scales_of", lambda _, meshes: [1.0] * meshes),
        # Nor has any the values and neighbours that a map's check looks at.
        mock.patch.object(map_check, "doubts_about", return_value=[]),
    ):
        yield


def _nothing(*_: Any, **__: Any) -> None:
    """In place of a launch."""


def _one() -> int:
    return 1


def _stop(*_: Any) -> None:
    raise FirstLaunch


def entered(call: Callable[[], object]) -> list[tuple[str, str]]:
    """File and name of the project's functions that a call enters, in the order in which they are first entered."""
    # Where the kernels are a link, Python names their files by the link or by what it leads to.
    roots = str(PACKAGE) + os.sep, str(PACKAGE.joinpath("kernels").resolve()) + os.sep
    found: dict[tuple[str, str], None] = {}

    def watch(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(roots) and not code.co_name.startswith("<"):
            found[code.co_filename, code.co_qualname] = None

    sys.setprofile(watch)
    try:
        with suppress(FirstLaunch):
            call()
    finally:
        sys.setprofile(None)
    return [(file, name) for file, name in found if file not in LAUNCH and file != __file__]


def measured(call: Callable[[], Callable[[], object]], repeats: int) -> Report:
    """The report of calls: `call` prepares one and returns it."""
    with without_launches():
        for _ in range(3):
            call()()
        functions = _fewest(call)
        us = min(_us(call()) for _ in range(repeats))
    with without_launches(_stop):
        before = _fewest(call)
        before_us = min(_us(call()) for _ in range(repeats))
    return Report(_host(before, before_us), _host(functions, us))


def _fewest(call: Callable[[], Callable[[], object]]) -> list[tuple[str, str]]:
    # Views of memory are remembered by its address, which now and then is a new one.
    return min((entered(call()) for _ in range(8)), key=len)


def _us(call: Callable[[], object]) -> float:
    begin = time.thread_time()
    with suppress(FirstLaunch):
        call()
    return 1e6 * (time.thread_time() - begin)


def _host(functions: list[tuple[str, str]], us: float) -> Host:
    return Host(len(functions), len({file for file, _ in functions}), us)


def calls(triangles: int, resolution: int) -> dict[str, Callable[[], Callable[[], object]]]:
    """Calls by name, each prepared anew: of meshes never seen before, no two with equal counts, and of one that was."""
    vertices, faces = (torch.from_numpy(array) for array in torus(triangles))
    grid = sdm.Grid((-1.2,) * 3, (2.4 / (resolution - 1),) * 3, (resolution,) * 3)
    batch, mesh = vertices[None], sdm.TriangleMesh(vertices, faces)

    numbers = count()

    def new() -> Callable[[], object]:
        other = sdm.TriangleMesh(*torus(triangles + 8 * next(numbers)), check=False)
        return lambda: sdm.signed_distance_map(other, grid, device="cpu")

    return {
        "signed_distance_map, new mesh": new,
        "signed_distance_map, mesh seen before": lambda: lambda: sdm.signed_distance_map(mesh, grid, device="cpu"),
        "signed_distance_maps, mesh seen before": lambda: (
            lambda: sdm.signed_distance_maps(batch, faces, grid, device="cpu")
        ),
    }


def main() -> None:
    """Print the table, and with `--profile` where a new mesh's time goes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--triangles", type=int, default=2000, help="triangles of the mesh")
    parser.add_argument("--resolution", type=int, default=64, help="voxels along each axis")
    parser.add_argument("--repeats", type=int, default=300, help="calls that the least time is taken of")
    parser.add_argument("--profile", action="store_true", help="also print a profile of calls with new meshes")
    options = parser.parse_args()
    made = calls(options.triangles, options.resolution)
    # Kernels are compiled and loaded by calls that launch them.
    for call in made.values():
        call()()
    print(f"{'':40}{'before the first launch':>30}{'whole call':>30}")
    print(f"{'':40}" + 2 * f"{'functions':>10}{'files':>10}{'us':>10}")
    for name, call in made.items():
        found = measured(call, options.repeats)
        parts = (f"{host.functions:>10}{host.files:>10}{host.us:>10.0f}" for host in (found.before, found.whole))
        print(f"{name:40}" + "".join(parts))
    if options.profile:
        profile = cProfile.Profile()
        with without_launches():
            prepared = [made["signed_distance_map, new mesh"]() for _ in range(options.repeats)]
            profile.enable()
            for call in prepared:
                call()
            profile.disable()
        pstats.Stats(profile).sort_stats("tottime").print_stats(40)


if __name__ == "__main__":
    main()
