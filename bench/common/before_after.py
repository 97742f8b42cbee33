"""Two checkouts of sdm by turns on one machine: is the newer one slower, and does it give the same distances?

    python -m sdm.bench.common.before_after --before PATH --device cuda --out FILE.json

Each turn is a process of its own that imports one of the checkouts and times what users call: a map that is asked about
again (`repeated`), a map of a mesh whose counts were never seen (`first`, the process being warm) with the host's share
of it, scattered points, a batch, the stream. The medians over all turns are compared. Timed with CUDA events on a GPU
and with a clock on a CPU; the meshes are those of the table of `sdm.bench.dense`.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

RESOLUTIONS = {"cuda": (64, 128, 256, 512), "cpu": (64, 128)}
MESHES = {
    "cuda": ("rocker-arm", "stanford-bunny", "nefertiti", "torus"),
    "cpu": ("rocker-arm", "fandisk", "nefertiti", "stanford-bunny"),
}
POINTS = {"cuda": 10_000_000, "cpu": 100_000}
# A mesh has new counts when a few vertices that no face uses are added.
SPARE = 1000


def torus(triangles: int) -> tuple[Any, Any]:
    """A torus of about so many triangles."""
    import numpy as np

    n = max(3, round((triangles / 4) ** 0.5))
    u, v = np.meshgrid(np.arange(2 * n) * np.pi / n, np.arange(n) * 2 * np.pi / n, indexing="ij")
    ring = 0.7 + 0.25 * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), 0.25 * np.sin(v)], -1).reshape(-1, 3).astype(np.float32)
    i, j = np.meshgrid(np.arange(2 * n), np.arange(n), indexing="ij")
    a, b = i * n + j, (i + 1) % (2 * n) * n + j
    c, d = (i + 1) % (2 * n) * n + (j + 1) % n, i * n + (j + 1) % n
    return points, np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3).astype(np.int32)


class Turn:
    """One process's measurements.

    Args:
        device: "cuda" or "cpu".
        budget_s: Seconds for each figure at most.
    """

    def __init__(self, device: str, budget_s: float) -> None:
        import torch

        self.device, self.budget_s, self.torch = device, budget_s, torch
        self.figures: dict[str, list[float]] = {}

    def wait(self) -> None:
        """Until the device is idle."""
        if self.device == "cuda":
            self.torch.cuda.synchronize()

    def once(self, call: Callable[[], Any]) -> tuple[float, float]:
        """Milliseconds of a call on the device, and of the host until the call returned."""
        self.wait()
        if self.device == "cuda":
            begin, end = (self.torch.cuda.Event(enable_timing=True) for _ in range(2))
            begin.record()
            start = time.perf_counter()
            call()
            host = time.perf_counter() - start
            end.record()
            self.wait()
            return begin.elapsed_time(end), 1e3 * host
        start = time.perf_counter()
        call()
        took = 1e3 * (time.perf_counter() - start)
        return took, took

    def time(self, name: str, call: Callable[[int], Any], runs: int, warm: int = 3) -> None:
        """Note the times of `runs` calls under `name`, fewer if they take longer than the budget."""
        for n in range(warm):
            call(n - warm)
        took, host = [], []
        stop = time.monotonic() + self.budget_s
        for n in range(runs):
            device, on_host = self.once(lambda n=n: call(n))
            took.append(device)
            host.append(on_host)
            if time.monotonic() > stop:
                break
        self.figures[name] = took
        if self.device == "cuda" and " first " in name:
            self.figures[name + " host"] = host


def measure(device: str, folder: Path, values: Path, budget_s: float) -> dict[str, list[float]]:
    """All figures of the checkout that is imported; the maps' values go to `values` for the comparison."""
    import numpy as np

    import sdm

    turn = Turn(device, budget_s)
    kept: dict[str, Any] = {}
    for name in MESHES[device]:
        if name == "torus":
            vertices, faces = torus(1_000_000)
            mesh = sdm.TriangleMesh(vertices, faces, name)
        else:
            mesh = sdm.load_mesh(folder / f"{name}.ply")
        mesh = mesh.to(device)
        for n in RESOLUTIONS[device]:
            grid = sdm.Grid.around(mesh, resolution=n)

            def again(_: int, grid: Any = grid, mesh: Any = mesh) -> Any:
                return sdm.signed_distance_map(mesh, grid, device=device)

            # Many first calls at 64^3, where the host decides; fewer of the large ones.
            turn.time(f"{name} {n} repeated", again, 40 if n < 512 else 15, warm=5)
            _first(turn, f"{name} {n} first", mesh, grid, runs=24 if n < 256 else 10)
            part = again(0).values.reshape(-1)[:: max(1, n**3 // 200_000)]
            kept[f"{name} {n}"] = part.cpu().numpy()
        if name == "rocker-arm":
            _points(turn, sdm, mesh, kept)
            _batch(turn, sdm, mesh)
    _stream(turn, sdm)
    np.savez(values, **kept)
    return turn.figures


def _first(turn: Turn, name: str, mesh: Any, grid: Any, runs: int) -> None:
    import torch

    import sdm

    meshes = []
    for k in range(runs + 2):
        spare = mesh.vertices[:1].expand(SPARE + k, 3)
        meshes.append(sdm.TriangleMesh(torch.cat([mesh.vertices, spare]), mesh.faces.clone(), check=False))
    turn.time(name, lambda k: sdm.signed_distance_map(meshes[k], grid, device=turn.device), runs, warm=2)


def _points(turn: Turn, sdm: Any, mesh: Any, kept: dict[str, Any]) -> None:
    import torch

    count = POINTS[turn.device]
    rng = torch.Generator().manual_seed(0)
    low, high = mesh.vertices.cpu().amin(0), mesh.vertices.cpu().amax(0)
    points = (low + (high - low) * (1.2 * torch.rand(count, 3, generator=rng) - 0.1)).to(turn.device)
    index = sdm.MeshIndex(mesh, turn.device)
    turn.time("points", lambda _: index.signed_distance(points), 10)
    kept["points"] = index.signed_distance(points[:100_000]).cpu().numpy()


def _batch(turn: Turn, sdm: Any, mesh: Any) -> None:
    import torch

    size = 64 if turn.device == "cuda" else 4
    grid = sdm.Grid.around(mesh, resolution=64)
    scale = torch.linspace(0.8, 1.0, size, device=turn.device)[:, None, None]
    vertices = (mesh.vertices[None] * scale).contiguous()
    turn.time(f"batch of {size}", lambda _: sdm.signed_distance_maps(vertices, mesh.faces, grid), 20, warm=5)


def _stream(turn: Turn, sdm: Any) -> None:
    family = sdm.shapes.Cochlea(triangles=20_000 if turn.device == "cuda" else 2_000)
    size = 16 if turn.device == "cuda" else 2
    batches = iter(sdm.SDMStream(family, family.grid(64), batch_size=size, seed=0, device=turn.device))
    # On a GPU one call of four makes the batches of the next four, and the others hand them out: only together are they
    # a figure. One call's median lay between two kinds of calls, which take 20 and 28 microseconds.
    together = 4 if turn.device == "cuda" else 1
    name = f"stream, {together * size} samples in batches of {size}"
    turn.time(name, lambda _: [next(batches) for _ in range(together)], 60 if turn.device == "cuda" else 6, warm=8)


def compare(before: Path, device: str, turns: int, folder: Path, budget_s: float) -> dict[str, Any]:
    """Run both checkouts by turns and compare medians and values."""
    import numpy as np

    here = Path(__file__).resolve().parents[2]
    figures: dict[str, dict[str, list[float]]] = {"before": {}, "after": {}}
    with tempfile.TemporaryDirectory() as work:
        for turn in range(turns):
            for side, root in (("before", before), ("after", here)):
                values = Path(work) / f"{side}.npz"
                paths = os.pathsep.join([str(root), *filter(None, [os.environ.get("PYTHONPATH")])])
                words = [
                    "--worker",
                    str(values),
                    "--device",
                    device,
                    "--data",
                    str(folder),
                    "--budget-s",
                    str(budget_s),
                ]
                run = subprocess.run(
                    [sys.executable, str(Path(__file__).resolve()), *words],
                    env={**os.environ, "PYTHONPATH": paths},
                    cwd=work,
                    stdout=subprocess.PIPE,
                    check=True,
                )
                for name, took in json.loads(run.stdout.splitlines()[-1]).items():
                    figures[side].setdefault(name, []).extend(took)
                print(f"turn {turn + 1} of {turns}, {side}: done", file=sys.stderr, flush=True)
        old, new = (dict(np.load(Path(work) / f"{side}.npz")) for side in ("before", "after"))
    differences = {name: float(np.nanmax(np.abs(old[name] - new[name]))) for name in old}
    signs = {name: int((np.signbit(old[name]) != np.signbit(new[name])).sum()) for name in old}
    rows = []
    for name, took in figures["after"].items():
        one, other = statistics.median(figures["before"][name]), statistics.median(took)
        rows.append({"figure": name, "before_ms": one, "after_ms": other, "ratio": other / one, "runs": len(took)})
    return {"rows": rows, "largest_difference": differences, "other_signs": signs}


def main() -> int:
    """As the module says."""
    parser = argparse.ArgumentParser("python -m sdm.bench.common.before_after", description=__doc__)
    parser.add_argument("--before", type=Path, help="folder of the older checkout")
    parser.add_argument("--device", choices=("cuda", "cpu"), default="cpu")
    parser.add_argument("--turns", type=int, default=2, help="processes of each checkout")
    parser.add_argument("--data", type=Path, default=None, help="folder with the meshes (default: $SDM_DATA/meshes)")
    parser.add_argument("--budget-s", type=float, default=2.0, help="seconds for each figure of a process")
    parser.add_argument("--out", type=Path, help="JSON file")
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    folder = options.data or Path(os.environ.get("SDM_DATA", "../shared/data")) / "meshes"
    if options.worker is not None:
        print(json.dumps(measure(options.device, folder.resolve(), options.worker, options.budget_s)))
        return 0
    if options.before is None or not (options.before / "sdm").is_dir():
        print("name the folder of the older checkout with --before", file=sys.stderr)
        return 2
    found = compare(options.before.resolve(), options.device, options.turns, folder.resolve(), options.budget_s)
    for row in found["rows"]:
        print(f"{row['figure']:32} {row['before_ms']:10.3f} {row['after_ms']:10.3f} ms  x {row['ratio']:.3f}")
    print(
        "other signs:",
        sum(found["other_signs"].values()),
        " largest difference:",
        max(found["largest_difference"].values()),
    )
    if options.out is not None:
        from sdm.bench.common.json_file import write
        from sdm.bench.common.machine import describe

        write(options.out, {"machine": describe(options.device), **found})
    return 0


if __name__ == "__main__":
    sys.exit(main())
