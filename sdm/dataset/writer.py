"""Writer of a dataset: plan it, find what is missing, share out the shards, give it its name."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from sdm.core.as_grid import GridLike
from sdm.core.given_values import as_path, whole
from sdm.core.grid import Grid
from sdm.dataset import layout
from sdm.dataset.family_registry import other_family, with_reference
from sdm.dataset.manifest import COMPRESSIONS, read_manifest, require_draws
from sdm.dataset.shard_job import Job
from sdm.dataset.shard_paths import rows_of
from sdm.dataset.versions import VERSION
from sdm.engine.arguments import Sign
from sdm.errors import FormatError, SDMError
from sdm.io.files.leftovers import remove_leftovers_of
from sdm.io.files.lock import alone
from sdm.io.files.stand_in import known, moved
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.devices import device_kind, devices_for
from sdm.runtime.sharing.folder_job import ShardTold, this_process
from sdm.runtime.sharing.process_count import processes_for
from sdm.runtime.sharing.processes import run_here
from sdm.runtime.sharing.ray_cluster import run_on_ray
from sdm.shapes import Family
from sdm.stream import Sampler, as_sampler, sample_maker
from sdm.stream.sample_maker import Maker

# Files of one dataset: beyond, folders and the list of checksums are slower than the maps.
MOST_FILES = 10_000_000
# Of maps that one process of an H100's host makes of shapes that take long, by which each GPU gets a process.
BYTES_A_SECOND = 1e8

Progress = Callable[[int, int], None]


def generate(
    family: Family,
    grid: GridLike,
    count: int,
    path: str | Path,
    *,
    seed: int = 0,
    sampler: Sampler | str = "uniform",
    dtype: torch.dtype = torch.float32,
    truncate: float | None = None,
    sign: Sign = "winding",
    hole_size: float | None = None,
    shard: int | None = None,
    compression: str = "zstd",
    device: str | torch.device | None = None,
    processes: list[str] | None = None,
    ray: str | None = None,
    resume: bool = False,
    source: dict[str, Any] | None = None,
    progress: Progress | None = None,
    times: StageTimes | None = None,
) -> Path:
    """Write samples 0 to `count` - 1 of a stream to a Zarr 3 dataset: bit for bit what `SDMStream` yields.

    Args:
        family: The shapes.
        grid: Where to measure, as for `SDMStream`.
        count: Number of samples.
        path: The dataset to write, a folder that is not there yet. Until it is complete it is called `path`.part.
        seed: As of `SDMStream`.
        sampler: As of `SDMStream`.
        dtype: float32 or float16.
        truncate: Distances beyond this (in the family's unit) become this, with their sign.
        sign: As of `SDMStream`.
        hole_size: As of `SDMStream`.
        shard: Samples in one file; by default 256 MiB of them.
        compression: "zstd" (lossless) or "none".
        device: "cuda:1", "cpu", ...; by default every GPU there is, else the CPU.
        processes: The device of each process that makes maps, in place of `device`; by default one for each GPU.
        ray: Address of a Ray cluster whose GPUs share the work ("auto" for the one this machine is in).
        resume: Finish an unfinished dataset of the same recipe; what is there stays.
        source: What the family was made from, kept in the manifest.
        progress: Called with the number of samples on the disk and `count`.
        times: The clock of the stages, which hears those of other processes.

    Returns:
        The path.

    Raises:
        FormatError: The path is taken, the unfinished dataset is another one, of an sdm that drew other random
            numbers, or another process writes it, or the disk cannot be written.
        SDMError: A number that makes no sense.

    Killed at any moment it loses the shards in flight; `resume` finishes it to the identical dataset on the same kind
    of device.
    """
    target = as_path(path)
    folder = layout.part_of(target)
    check_options(count, dtype=dtype, shard=shard, compression=compression)
    # The manifest takes no number of NumPy's.
    count, shard = int(count), None if shard is None else int(shard)
    devices = ["cpu"] if ray is not None else devices_for(device) if processes is None else processes
    # Refuses what makes no sense before anything is on the disk.
    signs: dict[str, Any] = {"sign": sign, "hole_size": hole_size}
    maker = Maker(family, grid, seed=seed, sampler=sampler, device="cpu", dtype=dtype, truncate=truncate, **signs)
    at: Grid = maker.grid
    recipe = maker.recipe
    sample_bytes = at.size * (2 if dtype == torch.float16 else 4)
    manifest = {
        "version": VERSION,
        "sign": "negative inside",
        "recipe": recipe,
        "count": count,
        "shard": shard or layout.samples_of_a_shard(sample_bytes, count),
        "compression": compression,
        "parameters": [{"name": p.name, "low": p.low, "high": p.high, "unit": p.unit} for p in family.parameters],
        "transforms": family.places_meshes,
        "rejected": [list(pair) for pair in family.rejected],
        "sdm_version": version(),
        "device": None if ray is not None else device_kind(devices[0]),
        "source": with_reference(family, source),
    }
    files = layout.shard_count(manifest)
    if files > MOST_FILES:
        raise SDMError(
            f"{count:,} samples in files of {manifest['shard']:,} are {files:,} files; at most {MOST_FILES:,} are "
            "supported: give a lower count or resolution, or more samples in one file (--shard)"
        )
    # How many samples are in one file is the dataset's own affair, unless somebody says.
    wanted = {**manifest, "shard": shard}
    if resume and target.exists():
        same(read_manifest(target), wanted, target)
        return target
    manifest = begin(target, folder, manifest, wanted if resume else None)
    job = Job(folder, manifest, family, at, as_sampler(sampler), seed, dtype, truncate, sign, hole_size, known())
    with alone(folder):
        fill(job, devices, ray, progress, times, processes)
        finish(folder, target)
    return target


def check_options(
    count: int,
    *,
    dtype: torch.dtype = torch.float32,
    shard: int | None = None,
    compression: str = "zstd",
    **of_stream: Any,
) -> None:
    """Refuse options of `generate` that make no sense whatever the family and the grid, before a shape is made.

    Args:
        count: As of `generate`.
        dtype: As there.
        shard: As there.
        compression: As there.
        of_stream: Those that streams have too.

    Raises:
        SDMError: A number, a name or a type that there is not.
    """
    if whole(count, 1) is None:
        raise SDMError(f"a dataset of {count!r} samples was requested; give at least 1")
    if shard is not None and whole(shard, 1) is None:
        raise SDMError(f"a shard of {shard!r} samples was requested; give at least 1")
    if not isinstance(compression, str) or compression not in COMPRESSIONS:
        raise SDMError(f"there is no compression called {compression!r}; use {' or '.join(COMPRESSIONS)}")
    if dtype not in (torch.float32, torch.float16):
        raise SDMError(f"datasets of type {dtype} are not supported; use float32 or float16")
    sample_maker.check_options(dtype=dtype, **of_stream)


def check_place(target: Path, *, resume: bool = False) -> None:
    """Refuse a place where no dataset can be begun, or with `resume` no unfinished one be gone on with.

    Raises:
        FormatError: It is taken, or its folder is not there.
    """
    folder = layout.part_of(target)
    if target.exists():
        raise FormatError(f"{target} is there already: choose another name, or remove it")
    if not target.parent.is_dir():
        raise FormatError(f"{target} cannot be written: the folder {target.parent} is not there; make it first")
    if not resume and folder.exists():
        raise _unfinished(folder)


def _unfinished(folder: Path) -> FormatError:
    # One that another process is at work on is neither to be finished nor to be removed, which this says.
    with alone(folder):
        pass
    return FormatError(f"{folder} is an unfinished dataset: --resume finishes it; or remove it")


def begin(target: Path, folder: Path, manifest: dict[str, Any], wanted: dict[str, Any] | None) -> dict[str, Any]:
    """Make the unfinished dataset, or take the one that is there if it is as `wanted`; its manifest."""
    check_place(target, resume=wanted is not None)
    remove_leftovers_of(folder)
    if not folder.exists():
        try:
            layout.create(folder, manifest)
        except OSError as error:
            # Another process may have begun it in the meantime.
            if not folder.exists():
                raise FormatError(f"{target} cannot be written: {error.strerror or error}") from error
        else:
            return manifest
    if wanted is None:
        raise _unfinished(folder)
    found = read_manifest(folder)
    same(found, wanted, folder)
    return found


def same(found: dict[str, Any], wanted: dict[str, Any], path: Path) -> None:
    """Refuse a dataset that is there and not the one that is requested.

    Raises:
        FormatError: It is not; says in what.
    """
    require_draws(found, path)
    name = wanted["recipe"]["family"]
    # First, as another grid may follow from it.
    if found["recipe"]["family"] == name and (what := other_family(found, wanted)):
        raise FormatError(f"{path} was begun from another {name}: other {what} than requested now")
    others = ("count", "shard", "compression", "sdm_version", "device")
    for key, value in {**wanted["recipe"], **{k: wanted[k] for k in others}}.items():
        there = found["recipe"].get(key, found.get(key))
        # None says something about these, and nothing about the others.
        says = key in ("truncate", "hole_size") or (there is not None and value is not None)
        if says and there != value:
            raise FormatError(_difference(found, path, key, there, value))


def _difference(found: dict[str, Any], path: Path, key: str, there: Any, value: Any) -> str:
    """A sentence about what a dataset was begun with, and what is requested in its place."""
    folder = (found.get("source") or {}).get("folder")
    if key == "family" and folder is not None:
        named = f": name the folder by its path (./{value})" if Path(folder).name == value else ""
        return f"{path} was begun from the folder {folder}, but the family {value} was requested{named}"
    if key == "fingerprint":
        what = f"the meshes of {folder} are" if folder is not None else f"{found['recipe']['family']} is"
        return f"{what} not what {path} was begun from: other faces, constants or files; mend that, or begin a new one"
    if key == "grid":
        there, value = (
            f"{grid.summary} from ({', '.join(f'{x:.4g}' for x in grid.origin)}) on"
            for grid in (Grid(**there), Grid(**value))
        )
    return f"{path} has {key} {there}, but {value} was requested: ask for the same, or for a new one"


def fill(
    job: Job,
    devices: list[str],
    ray: str | None,
    progress: Progress | None,
    times: StageTimes | None = None,
    processes: list[str] | None = None,
) -> None:
    """Make every shard that is missing."""
    count = layout.shard_count(job.manifest)
    missing = [n for n in range(count) if not layout.is_done(job.folder, job.manifest, n)]
    remake(job, missing, devices, ray, progress, times, processes)


def remake(
    job: Job,
    shards: list[int],
    devices: list[str],
    ray: str | None,
    progress: Progress | None,
    times: StageTimes | None = None,
    processes: list[str] | None = None,
) -> None:
    """Make these shards, whatever is there."""
    rows = [end - begin for begin, end in (rows_of(job.manifest, n) for n in shards)]
    sizes = dict(zip(shards, rows, strict=True))
    total = job.manifest["count"]
    written = total - sum(rows)

    def done(told: ShardTold) -> None:
        nonlocal written
        written += sizes[told.number]
        if times is not None and told.process != this_process():
            times.hear(told.process, told.times)
        if progress is not None:
            progress(written, total)

    if progress is not None:
        progress(written, total)
    if not shards:
        return
    if ray is not None:
        run_on_ray(job, shards, ray, done)
    else:
        run_here(job, shards, processes or processes_of(job, sum(rows), devices), done, times)


def processes_of(job: Job, maps: int, devices: list[str]) -> list[str]:
    """The device of each process that makes so many maps: see `processes_for`."""
    # One makes more than a disk takes, beside those that write (`shard_stage`).
    return processes_for(devices, maps * job.grid.size * job.dtype.itemsize / BYTES_A_SECOND, several=False)


def finish(folder: Path, target: Path) -> None:
    """Give the finished dataset its name."""
    # What killed processes have left.
    for leftover in folder.rglob(".*.part"):
        shutil.rmtree(leftover, ignore_errors=True) if leftover.is_dir() else leftover.unlink()
    try:
        folder.rename(target)
        moved(folder, target)
    except OSError as error:
        raise FormatError(f"{target} cannot be written: {error.strerror or error}; the data is in {folder}") from error


def version() -> str:
    """The version of sdm that makes the data."""
    import sdm

    return sdm.__version__
