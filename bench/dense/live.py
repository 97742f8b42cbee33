"""Frames of a mesh whose vertices move: milliseconds of a map, structure counted, memory and waits.

    python -m sdm.bench.dense.live --device cuda --out live-cuda.json

A torus of `--triangles` breathes: every frame has new vertices, made on the device before, and asks for its map, by
`MeshIndex.update` and `signed_distance_map`, by a whole call, and by `signed_distance_maps` of a batch of one. The time
of a frame is that of `--frames` frames, one after the other without a wait, by CUDA events, divided by their number;
beside it the host's time until a frame returns. `allocations` is how often the frames made torch ask the driver for
memory, `waits` how often one waited for the device, as torch's synchronisation check and a count of synchronised
events tell. The last map has to equal that of a plain call bit for bit.
"""

from __future__ import annotations

import argparse
import statistics
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from torch import Tensor

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.figure import drawing
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import torus
from sdm.runtime import graphs

RESOLUTIONS = (32, 64, 128)
WARM = 12
# Ways by what a reader calls them.
CALLS = {
    "update": "index.update, index.signed_distance_map",
    "signed_distance_map": "sdm.signed_distance_map",
    "signed_distance_maps": "sdm.signed_distance_maps, a batch of one",
}


def ways(vertices: Tensor, faces: Tensor, grid: sdm.Grid, device: str) -> dict[str, Callable[[Tensor], Tensor]]:
    """Ways to ask for the map of moved vertices (V,3)."""
    index = sdm.MeshIndex(sdm.TriangleMesh(vertices, faces, check=False), device, warn=False)

    def update(moved: Tensor) -> Tensor:
        index.update(moved)
        return index.signed_distance_map(grid).values

    return {
        "update": update,
        "signed_distance_map": lambda moved: (
            sdm.signed_distance_map(sdm.TriangleMesh(moved, faces, check=False), grid, device=device).values
        ),
        "signed_distance_maps": lambda moved: sdm.signed_distance_maps(moved[None], faces, grid, device=device)[0],
    }


def frames_of(vertices: Tensor, count: int) -> list[Tensor]:
    """Vertices of each frame."""
    size = vertices.norm(dim=1, keepdim=True)
    return [vertices * (1 + 0.1 * torch.sin(5 * size + 0.1 * number)) for number in range(count)]


def row(way: Callable[[Tensor], Tensor], moved: list[Tensor], device: str) -> dict[str, Any]:
    """The figures of one way."""
    gpu = device.startswith("cuda")
    for vertices in moved[:WARM]:
        way(vertices)
    if gpu:
        torch.cuda.synchronize()
    before = _allocations(gpu)
    hosts = []
    begin = time.perf_counter()
    marks = [torch.cuda.Event(enable_timing=True) for _ in range(2)] if gpu else []
    if gpu:
        marks[0].record()
    for vertices in moved:
        start = time.perf_counter()
        values = way(vertices)
        hosts.append(1e6 * (time.perf_counter() - start))
    if gpu:
        marks[1].record()
        marks[1].synchronize()
    elapsed = marks[0].elapsed_time(marks[1]) if gpu else 1e3 * (time.perf_counter() - begin)
    return {
        "frame_ms": elapsed / len(moved),
        "host_us": statistics.median(hosts),
        "allocations": _allocations(gpu) - before,
        "waits": _waits(way, moved[:WARM], gpu),
        "values": values,
    }


def _allocations(gpu: bool) -> int:
    """Segments of memory that torch has asked the driver for."""
    return int(torch.cuda.memory_stats().get("segment.all.allocated", 0)) if gpu else 0


def _waits(way: Callable[[Tensor], Tensor], moved: list[Tensor], gpu: bool) -> int:
    """Waits for the device in so many frames."""
    if not gpu:
        return 0
    counted = 0
    plain = torch.cuda.Event.synchronize

    def synchronize(event: torch.cuda.Event) -> None:
        nonlocal counted
        counted += 1
        plain(event)

    with (
        warnings.catch_warnings(record=True) as caught,
        mock.patch.object(torch.cuda.Event, "synchronize", synchronize),
    ):
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            for vertices in moved:
                way(vertices)
        finally:
            torch.cuda.set_sync_debug_mode("default")
    return counted + len([warning for warning in caught if "called a synchronizing" in str(warning.message)])


def draw(report: dict[str, Any], path: Path) -> None:
    """Milliseconds of a frame by way and grid."""
    told = f"{report['machine']['device']}: {report['triangles']:,} triangles whose vertices move, structure and map"
    with drawing(path, told) as (_, axes):
        found_ways = list(dict.fromkeys(found["way"] for found in report["rows"]))
        for number, way in enumerate(found_ways):
            rows = [found for found in report["rows"] if found["way"] == way]
            places = [place + 0.25 * (number - (len(found_ways) - 1) / 2) for place in range(len(rows))]
            bars = axes.bar(places, [found["frame_ms"] for found in rows], 0.23, label=CALLS[way])
            axes.bar_label(bars, fmt="%.2f", fontsize=9)
            axes.set_xticks(range(len(rows)), [f"{found['resolution']}³" for found in rows])
        axes.set_xlabel("voxels")
        axes.set_ylabel("milliseconds of a frame")
        axes.set_title("A mesh that moves: time of a frame", loc="left")
        axes.legend(fontsize=9)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--triangles", type=int, default=5000)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--resolutions", type=int, nargs="*", default=list(RESOLUTIONS))
    parser.add_argument("--out", type=Path, help="a JSON file; a picture goes beside it")
    given = parser.parse_args()
    vertices, faces = (torch.from_numpy(array).to(given.device) for array in torus(given.triangles))
    moved, rows = frames_of(vertices, given.frames), []
    for resolution in given.resolutions:
        grid = sdm.Grid((-1.4,) * 3, (2.8 / (resolution - 1),) * 3, (resolution,) * 3)
        with graphs.paused():
            plain = sdm.signed_distance_map(sdm.TriangleMesh(moved[-1], faces.clone(), check=False), grid).values
        for name, way in ways(vertices, faces, grid, given.device).items():
            found = row(way, moved, given.device)
            equal = bool(torch.equal(found.pop("values"), plain))
            print(
                f"{name:24}{resolution}^3: {found['frame_ms']:.3f} ms a frame, host {found['host_us']:.0f} us, "
                f"{found['allocations']} allocations, {found['waits']} waits in {WARM} frames"
                + ("" if equal else ", the maps differ"),
                flush=True,
            )
            rows.append({"way": name, "resolution": resolution, **found, "equal": equal})
    report = {
        "machine": describe(given.device),
        "triangles": len(faces),
        "frames": given.frames,
        "rows": rows,
    }
    if given.out:
        json_file.write(given.out, report)
        draw(report, given.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
