"""Several GPUs, and several processes on one: how fast are `sdm compute` and `sdm generate`?

    python -m sdm.bench.disk.devices --folder /dev/shm

Rates of all include the start of processes, which takes some ten seconds; `steady` ones are those between a quarter and
nineteen twentieths of the items. Meshes are `--meshes`, an eighth of them different, 20,000 triangles each, at 128^3 to
.npz; maps of `generate` are those of cochleas of 20,000 triangles at 64^3, float16 without compression and float32 as
zstd. Maps of all ways to share are compared byte by byte with those of one process.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch

import sdm
from sdm.bench.common import json_file
from sdm.bench.common.checkout import results_folder
from sdm.bench.common.machine import describe
from sdm.bench.disk.inputs import write_meshes
from sdm.bench.disk.steady import compute_rates, generate_rates
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.devices import devices_for
from sdm.shapes import Cochlea

TRIANGLES, MAPS_AT, MESHES_AT, ALIKE = 20_000, 64, 128, 8


def meshes_in(folder: Path, count: int) -> list[Path]:
    """Files of `count` meshes; of each that differs several names."""
    files = write_meshes(folder / "first", -(-count // ALIKE), TRIANGLES, "ply")
    found = []
    for number in range(count):
        file = folder / f"{number:06}.ply"
        os.link(files[number % len(files)], file)
        found.append(file)
    return found


def content(folder: Path) -> str:
    """Digest of names and contents of the files of a folder."""
    digest = hashlib.sha256()
    for file in sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "zarr.json"):
        digest.update(file.relative_to(folder).as_posix().encode() + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def compute_rows(folder: Path, count: int, ways: list[list[str]], checked: int) -> Iterator[dict[str, Any]]:
    """A row for each list of processes; the first `checked` maps of each are compared."""
    files, whole = meshes_in(folder / "meshes", count), set()
    for processes in ways:
        out = folder / "maps"
        out.mkdir()
        jobs = [(file, out / f"{file.stem}.npz") for file in files]
        row: dict[str, Any] = {"work": "compute .npz", "count": count, "processes": processes}
        row |= compute_rates(jobs, MESHES_AT, processes[0], StageTimes(), processes=processes)
        for _, target in jobs[checked:]:
            target.unlink()
        whole.add(content(out))
        shutil.rmtree(out)
        print(row, flush=True)
        yield row
        if len(whole) > 1:
            raise SystemExit("maps differ by who made them")


def generate_rows(
    folder: Path, count: int, ways: list[list[str]], dtype: torch.dtype, compression: str
) -> Iterator[dict[str, Any]]:
    """A row for each list of processes."""
    family, whole = Cochlea(TRIANGLES), set()
    for processes in ways:
        out = folder / "d.zarr"
        more: dict[str, Any] = {"dtype": dtype, "compression": compression, "processes": processes}
        found = generate_rates(family, family.grid(MAPS_AT), count, out, StageTimes(), **more)
        name = f"generate {str(dtype).removeprefix('torch.')} {compression}"
        row = {"work": name, "count": count, "processes": processes, **found}
        whole.add((out / "sha256").exists() and content(out / "sha256"))
        shutil.rmtree(out)
        print(row, flush=True)
        yield row
        if len(whole) > 1:
            raise SystemExit("datasets differ by who made them")


def main() -> None:
    """Measure, and write the record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, help="a place on the disk that counts")
    parser.add_argument("--meshes", type=int, default=3000, help="of compute; 0 leaves it out")
    parser.add_argument("--maps", type=int, default=40_000, help="of generate; 0 leaves it out")
    parser.add_argument("--processes", type=int, default=4, help="on each GPU")
    parser.add_argument("--checked", type=int, default=64, help="maps that are compared")
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args()
    every = devices_for(None)
    ways = [every[:1], every[:1] * options.processes]
    ways += [every, every * options.processes] if len(every) > 1 else []
    out = options.out or results_folder() / f"disk-devices-{every[0].partition(':')[0]}.json"
    record: dict[str, Any] = {"machine": describe(every[0]), "cores": len(os.sched_getaffinity(0))}
    record |= {"load": os.getloadavg()[0], "devices": every, "rows": []}
    folder = Path(tempfile.mkdtemp(prefix="sdm-disk-", dir=options.folder))
    try:
        # Kernels are compiled, recordings made, and memory touched.
        warm = write_meshes(folder / "warm", 8, TRIANGLES, "ply")
        (folder / "warm-maps").mkdir()
        first = [(file, folder / "warm-maps" / f"{file.stem}.npz") for file in warm]
        for file in warm[:3]:
            sdm.signed_distance_map(file, resolution=MESHES_AT, device=every[0])
        compute_rates(first, MESHES_AT, every[0], StageTimes(), processes=every[:1])
        plain, zstd = (torch.float16, "none"), (torch.float32, "zstd")
        for _ in generate_rows(folder, 2000, ways[:1], *plain) if options.maps else ():
            pass
        works: list[tuple[Callable[..., Iterator[dict[str, Any]]], int, tuple[Any, ...]]] = [
            (generate_rows, options.maps, plain),
            (compute_rows, options.meshes, (options.checked,)),
            (generate_rows, options.maps, zstd),
        ]
        for work, count, more in works:
            for row in work(folder, count, ways, *more) if count else ():
                record["rows"].append(row)
                # What is measured is kept, should the rest be cut off.
                json_file.write(out, record)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(out)


if __name__ == "__main__":
    main()
