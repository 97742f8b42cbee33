"""Several GPUs of one machine: are files the same whoever makes them, and what does the loss of a process cost?

    python -m sdm.bench.disk.shared_check --folder /dev/shm

Each command is done by one process on the first GPU and then shared among all GPUs, however little work it is; names
and contents of files are compared. Then one process of `sdm generate` is killed in the middle (SIGKILL): the command
must say so in one sentence, leave no process behind, and be finished by `--resume` to the same bytes.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import multiprocessing
import os
import shutil
import tempfile
import threading
import time
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

from sdm.bench.common import json_file
from sdm.bench.common.checkout import results_folder
from sdm.bench.common.machine import describe
from sdm.bench.disk.inputs import write_meshes
from sdm.cli.app import main as sdm_command
from sdm.dataset.layout import part_of
from sdm.runtime.sharing import process_count
from sdm.runtime.sharing.devices import devices_for

# Reports tell how long things took.
TELLS_TIMES = ("report.json",)


def files_in(folder: Path) -> dict[str, str]:
    """Digest of each file of a folder, but of those that tell times."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name not in TELLS_TIMES)
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def command(words: list[str]) -> tuple[int, str, float]:
    """Exit code, what was said of errors, and seconds of `sdm` with these words, in this process."""
    said, start = io.StringIO(), time.perf_counter()
    with redirect_stdout(io.StringIO()), redirect_stderr(said):
        code = sdm_command(words)
    return code or 0, said.getvalue(), time.perf_counter() - start


def same_files(name: str, words: list[str], folder: Path, first: str) -> dict[str, Any]:
    """A row: the command by one process and by all, and how many files are the same."""
    found, seconds = [], []
    for device, start in ((first, process_count.START), ("auto", 0.0)):
        out, before = folder / device.replace(":", "-") / name, process_count.START
        out.parent.mkdir(exist_ok=True)
        process_count.START = start
        try:
            code, said, spent = command([*words, "-o", str(out), "--device", device])
        finally:
            process_count.START = before
        if code:
            raise SystemExit(f"{name} by {device}: exit code {code}: {said}")
        found.append(files_in(out))
        seconds.append(round(spent, 1))
    if found[0] != found[1]:
        differ = sorted(key for key in found[0].keys() | found[1].keys() if found[0].get(key) != found[1].get(key))
        raise SystemExit(f"{name}: {len(differ)} files differ by who made them, such as {differ[:3]}")
    return {"work": name, "files": len(found[0]), "same": True, "seconds": seconds}


def lost_process(words: list[str], whole: Path, folder: Path, shards: int) -> dict[str, Any]:
    """A row: a process is killed once a shard is there; what is said, what is left, and the files after `--resume`."""
    out = folder / "killed.zarr"
    killed = threading.Event()

    def kill() -> None:
        marks = part_of(out) / "sha256" / "c"
        while not killed.is_set():
            # All but the first two are still to be done.
            if marks.is_dir() and any(marks.iterdir()) and (workers := multiprocessing.active_children()):
                workers[-1].kill()
                killed.set()
            time.sleep(0.002)

    watch = threading.Thread(target=kill, daemon=True)
    watch.start()
    code, said, _ = command([*words, "-o", str(out), "--device", "auto"])
    was_killed = killed.is_set()
    killed.set()
    watch.join()
    left = multiprocessing.active_children()
    done = len(list((part_of(out) / "sha256" / "c").glob("*"))) if part_of(out).is_dir() else shards
    again, more, _ = command([*words, "-o", str(out), "--device", "auto", "--resume"])
    sentences = [line for line in said.splitlines() if line.startswith("sdm: ")]
    row = {"work": "generate, a process killed", "killed": was_killed, "exit_code": code, "said": sentences}
    row |= {"processes_left": len(left), "shards_done": done, "shards": shards, "resumed": again}
    row["same"] = files_in(out) == files_in(whole)
    if not (was_killed and code == 2 and len(sentences) == 1 and not left and again == 0 and row["same"]):
        raise SystemExit(f"not as it must be: {row} {said} {more}")
    return row


def main() -> None:
    """Check, and write the record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, help="where to write; a place for temporary files by default")
    parser.add_argument("--meshes", type=int, default=96)
    parser.add_argument("--triangles", type=int, default=20_000)
    parser.add_argument("--resolution", type=int, default=128, help="of maps, and of the grids of surfaces")
    parser.add_argument("--points", type=int, default=50_000, help="samples of each mesh")
    parser.add_argument("--shards", type=int, default=96, help="of the dataset")
    parser.add_argument("--maps", type=int, default=64, help="of a shard, 64^3")
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args()
    every = devices_for(None)
    out = options.out or results_folder() / f"disk-shared-{every[0].partition(':')[0]}.json"
    record: dict[str, Any] = {"machine": describe(every[0]), "cores": len(os.sched_getaffinity(0)), "devices": every}
    record["rows"] = []
    folder = Path(tempfile.mkdtemp(prefix="sdm-shared-", dir=options.folder))
    meshes, at = str(folder / "meshes"), ["--resolution", str(options.resolution)]
    generated = ["generate", "cochlea", "--triangles", str(options.triangles), "--resolution", "64"]
    generated += ["--count", str(options.shards * options.maps), "--shard", str(options.maps)]
    works = (
        ("generate", generated),
        ("compute", ["compute", meshes, *at, "--format", "npz"]),
        ("sample", ["sample", meshes, "--count", str(options.points)]),
        ("watertight", ["watertight", meshes, *at]),
    )
    try:
        write_meshes(Path(meshes), options.meshes, options.triangles, "ply")
        for name, words in works:
            note(record, same_files(name, words, folder, every[0]), out)
        note(record, lost_process(generated, folder / "auto" / "generate", folder, options.shards), out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    print(out)


def note(record: dict[str, Any], row: dict[str, Any], out: Path) -> None:
    """Print a row, and keep it."""
    record["rows"].append(row)
    print(row, flush=True)
    json_file.write(out, record)


if __name__ == "__main__":
    main()
