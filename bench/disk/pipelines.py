"""The pipelines from disk to disk: rates, the busy share of each stage, and the engine alone beside them."""

from __future__ import annotations

import io
import time
from collections import deque
from collections.abc import Iterable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

import sdm
from sdm.bench.disk.inputs import write_meshes, write_small
from sdm.cli.maps.map_job import TOGETHER
from sdm.cli.maps.map_settings import Settings
from sdm.cli.maps.run import run as compute
from sdm.cli.maps.sample_run import SampleOptions
from sdm.cli.maps.sample_run import run as sample
from sdm.dataset import generate
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.shapes import Cochlea
from sdm.stream.sample_maker import Maker


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Sizes of the runs.

    Args:
        meshes: Files of `compute` and `sample`.
        triangles: Of each mesh.
        resolution: Of the maps of `compute`.
        maps: Of `generate`, 64^3.
        points: Samples of each mesh.
        threads: Of reading, and as many of writing, of `compute`; None for its own choice.
    """

    meshes: int
    triangles: int
    resolution: int
    maps: int
    points: int
    threads: int | None = None


def compute_rows(folder: Path, sizes: Sizes, device: str) -> tuple[list[dict[str, Any]], StageTimes]:
    """`sdm compute` of many binary PLY files, and the clock of the first run."""
    files = write_meshes(folder / "meshes", sizes.meshes, sizes.triangles, "ply")
    settings = settings_for(sizes.resolution, device)
    alone = alone_of_compute([sdm.load_mesh(file) for file in files], sizes.resolution, device)
    rows, first = [], None
    for ending in ("npz", "nii.gz"):
        out = folder / f"maps-{ending}"
        out.mkdir()
        times = StageTimes(keep_spans=True)
        jobs = [(file, out / f"{file.stem}.{ending}") for file in files]
        seconds, cpu = quietly(
            lambda jobs=jobs, times=times: compute(jobs, settings, workers=sizes.threads, times=times)
        )
        rows.append(_row(f"compute .{ending}", "meshes", sizes.meshes, seconds, cpu, times, alone, out))
        first = first or times
    return rows, first or StageTimes()


def alone_of_compute(meshes: list[sdm.TriangleMesh], resolution: int, device: str) -> tuple[float, float]:
    """Seconds, and those of the CPU, that the engine alone takes for the maps of meshes in memory, and keeps none."""
    # Before anything is timed: kernels are compiled, and recordings made.
    for mesh in meshes[:4]:
        sdm.signed_distance_map(mesh, resolution=resolution, device=device)
    _maps(meshes[:TOGETHER] if device != "cpu" else meshes[:1], resolution, device)
    return _seconds(device, lambda: _maps(meshes, resolution, device))


def small_run(folder: Path, files: int, resolution: int, device: str) -> tuple[float, StageTimes]:
    """Seconds of `sdm compute` of many small files to .npz, and its clock with every span of work."""
    out = folder / "maps"
    sources = write_small(folder / "meshes", files)
    jobs = [(file, out / file.parent.name / f"{file.stem}.npz") for file in sources]
    for place in {target.parent for _, target in jobs}:
        place.mkdir(parents=True)
    settings = settings_for(resolution, device)
    # Kernels are compiled, and recordings made.
    quietly(lambda: compute([(file, target.with_suffix(".first.npz")) for file, target in jobs[:TOGETHER]], settings))
    times = StageTimes(keep_spans=True)
    return quietly(lambda: compute(jobs, settings, times=times))[0], times


def together_on(device: torch.device) -> int:
    """Meshes that `sdm compute` measures in one call."""
    return TOGETHER if device.type == "cuda" else 1


def settings_for(resolution: int, device: str) -> Settings:
    """Settings of `sdm compute` at a resolution on a device, all others as they are by default."""
    return Settings(
        resolution=resolution,
        spacing=None,
        like=None,
        like_image=None,
        margin=0.05,
        device=torch.device(device),
        orient="keep",
        resume=False,
    )


def alone_of_generate(family: Cochlea, grid: sdm.Grid, maps: int, device: str) -> tuple[float, float]:
    """Seconds, and those of the CPU, that the engine alone takes for so many maps, and keeps none."""
    maker = Maker(family, grid, seed=0, sampler="uniform", device=device)
    numbers = torch.arange(maps, dtype=torch.int64, device="cpu").split(maker.at_once)
    for part in numbers[:4]:
        maker.make(part)
    return _seconds(device, lambda: _drop(maker.make(part) for part in numbers))


def generate_rows(folder: Path, sizes: Sizes, device: str) -> list[dict[str, Any]]:
    """`sdm generate cochlea`, 64^3, 20,000 triangles."""
    family = Cochlea(20_000)
    grid = family.grid(64)
    alone = alone_of_generate(family, grid, sizes.maps, device)
    rows = []
    for dtype, compression in ((torch.float16, "none"), (torch.float32, "zstd")):
        times, out = StageTimes(), folder / f"{compression}.zarr"
        seconds, cpu = quietly(
            lambda out=out, dtype=dtype, compression=compression, times=times: generate(
                family, grid, sizes.maps, out, dtype=dtype, compression=compression, device=device, times=times
            )
        )
        name = f"generate {str(dtype).removeprefix('torch.')} {compression}"
        rows.append(_row(name, "maps", sizes.maps, seconds, cpu, times, alone, out))
    return rows


def sample_row(folder: Path, sizes: Sizes, device: str) -> dict[str, Any]:
    """`sdm sample`, the layout of DeepSDF."""
    options = SampleOptions(
        law="paper",
        shares=(None, None, None),
        deviations=None,
        box=None,
        normalize=None,
        count=sizes.points,
        closest=False,
        sign="winding",
        hole_size=None,
        open_meshes="reject",
        seed=0,
    )
    meshes = sorted((folder / "meshes").glob("*.ply")) or write_meshes(
        folder / "meshes", sizes.meshes, sizes.triangles, "ply"
    )
    for mesh in meshes[:1]:
        sdm.sampling.sample(mesh, sizes.points, device=device)
    loaded = [sdm.load_mesh(mesh) for mesh in meshes]
    alone = _seconds(device, lambda: _drop(sdm.sampling.sample(mesh, sizes.points, device=device) for mesh in loaded))
    times, out = StageTimes(), folder / "samples"
    seconds, cpu = quietly(lambda: sample([folder / "meshes"], out, "deepsdf", options, device=device, times=times))
    return _row(f"sample {sizes.points:,}", "meshes", len(meshes), seconds, cpu, times, alone, out)


def _drop(made: Iterable[Any]) -> None:
    """Go through what is made, and keep none of it."""
    deque(made, maxlen=0)


def _maps(meshes: list[sdm.TriangleMesh], resolution: int, device: str) -> None:
    if device == "cpu":
        for mesh in meshes:
            sdm.signed_distance_map(mesh, resolution=resolution, device=device)
        return
    for begin in range(0, len(meshes), 8):
        sdm.signed_distance_maps(meshes[begin : begin + 8], resolution=resolution, device=device)


def _seconds(device: str, work: Any) -> tuple[float, float]:
    """Seconds, and those of the CPU."""
    start, cpu = time.perf_counter(), time.process_time()
    work()
    if device != "cpu":
        torch.cuda.synchronize(device)
    return time.perf_counter() - start, time.process_time() - cpu


def quietly(work: Any) -> tuple[float, float]:
    """Seconds of work that prints nothing, and those of the CPU."""
    start, cpu = time.perf_counter(), time.process_time()
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        work()
    return time.perf_counter() - start, time.process_time() - cpu


def _row(
    name: str,
    unit: str,
    count: int,
    seconds: float,
    cpu: float,
    times: StageTimes,
    alone: tuple[float, float],
    out: Path,
) -> dict[str, Any]:
    size = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    return {
        "work": name,
        "unit": unit,
        "count": count,
        "per_second": round(count / seconds, 2),
        "engine_alone_per_second": round(count / alone[0], 2),
        "of_engine": round(alone[0] / seconds, 3),
        "cpu_ms_each": round(1e3 * cpu / count, 2),
        "engine_alone_cpu_ms_each": round(1e3 * alone[1] / count, 2),
        "written_mb_per_s": round(size / 1e6 / seconds, 1),
        "busy_seconds": {stage: round(busy, 3) for stage, busy in times.seconds.items()},
    }
