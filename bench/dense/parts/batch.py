"""Part `batch`: many meshes with the same faces in one call, as a stream of training data asks for them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

import sdm
from sdm.bench.common.correctness import compare, voxel_centres
from sdm.bench.common.meshes import Case, load_case, missing_note
from sdm.bench.common.oracles.brute_force import Brute
from sdm.bench.common.query_points import generator
from sdm.bench.common.timing import median, once
from sdm.bench.dense.job import MIB, Job, as_dict, peak_mib
from sdm.runtime import graphs

BATCH, RESOLUTION = 64, 64
# A batch at a time that a training step takes, and a large one.
BATCHES = (16, BATCH)
CHECKED = 500
GRID = (-1.05, 1.05)


def family(job: Job, batch: int) -> tuple[str, np.ndarray, np.ndarray]:
    """A name, vertices (B,V,3) and faces (F,3): one mesh of about 20,000 triangles, bent in `batch` ways."""
    real = "rocker-arm"
    case = load_case("torus-500" if job.quick else "torus-20000" if missing_note(real) else real)
    low, high = case.box
    unit = (case.vertices - (low + high) / 2) / (high - low).max() * 1.5
    rng = generator(case, "batch")
    bent = []
    for _ in range(batch):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turn *= np.sign(np.linalg.det(turn))
        stretch, phase = rng.uniform(0.8, 1.0, 3), rng.uniform(0, 2 * np.pi, 3)
        v = unit * stretch
        v = v + 0.04 * np.sin(3.0 * np.roll(v, 1, 1) + phase)
        bent.append(v @ turn.T)
    return case.name, np.stack(bent).astype(np.float32), case.faces


def rows(job: Job) -> Iterator[dict[str, Any]]:
    """One row for each size of batch."""
    resolution = 16 if job.quick else RESOLUTION
    step = (GRID[1] - GRID[0]) / (resolution - 1)
    grid = sdm.Grid((GRID[0],) * 3, (step,) * 3, (resolution,) * 3)
    for batch in (2, 4) if job.quick else BATCHES:
        if not job.has_time(f"a batch of {batch}"):
            continue
        name, vertices, faces = family(job, batch)
        at, shared = torch.from_numpy(vertices).to(job.device), torch.from_numpy(faces).to(job.device)

        def call(at: Tensor = at, shared: Tensor = shared) -> Tensor:
            return sdm.signed_distance_maps(at, shared, grid)

        graphs.clear()
        first, values = once(call, job.device)
        if job.gpu:
            # The third call is recorded, so those that are timed are replayed.
            for _ in range(graphs.CALLS):
                call()
        timing = median(call, job.device, 3 * job.runs, 2e3)
        yield {
            "mesh": name,
            "triangles": len(faces),
            "batch": batch,
            "resolution": resolution,
            "call": as_dict(timing),
            "first_ms": first,
            "sdms_per_second": 1e3 * batch / timing.ms,
            "maps_mib": batch * grid.nbytes / MIB,
            "peak_mib": peak_mib(job, call),
            "checked": check(job, name, vertices, faces, grid, values),
            **(without_waiting(call, timing.ms) if job.gpu else {}),
        }


def check(job: Job, name: str, vertices: np.ndarray, faces: np.ndarray, grid: sdm.Grid, values: Tensor) -> list[Any]:
    """The first and the last map against the brute force."""
    found = []
    for which in (0, len(vertices) - 1):
        case = Case(f"{name} {which}", vertices[which], faces, frozenset())
        some = generator(case, "checked").integers(0, grid.size, CHECKED)
        at = voxel_centres(grid, some)
        brute = Brute(case.vertices, faces, job.device)
        mine = values[which].reshape(-1)[torch.from_numpy(some).to(values.device)].cpu().numpy()
        found.append(compare(case, at, mine, brute.distance(at)[0], brute.winding_number(at)).as_dict())
    return found


def without_waiting(call: Any, ms: float) -> dict[str, Any]:
    """Two proofs that a warm call leaves the device alone: torch allows no wait, and it returns while a GPU is busy."""
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        call()
        said = None
    except RuntimeError as error:
        said = str(error).split("\n", maxsplit=1)[0]
    finally:
        torch.cuda.set_sync_debug_mode("default")
    torch.cuda.synchronize()
    # About two billion cycles a second; far longer than the call's launches take.
    busy_s = max(0.2, 5e-3 * ms)
    torch.cuda._sleep(int(2e9 * busy_s))
    begin = time.perf_counter()
    call()
    returned = 1e3 * (time.perf_counter() - begin)
    torch.cuda.synchronize()
    done = 1e3 * (time.perf_counter() - begin)
    return {"sync_error": said, "returned_after_ms": returned, "device_done_after_ms": done}


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """The largest batch's speed, and whether anything waited."""
    if not found:
        return {}
    last = found[-1]
    waits = [row for row in found if "sync_error" in row]
    return {
        "batch": last["batch"],
        "sdms_per_second": last["sdms_per_second"],
        "no_host_sync": all(
            row["sync_error"] is None and row["returned_after_ms"] < row["device_done_after_ms"] / 2 for row in waits
        )
        if waits
        else None,
        "wrong": sum(tally["wrong_signs"] + tally["over_limit"] for row in found for tally in row["checked"]),
    }


def lines(found: list[dict[str, Any]], total: dict[str, Any]) -> list[list[str]]:
    """A table to print: header first."""
    table = [["meshes", "triangles", "N", "SDM/s", "call ms", "± %", "peak MiB", "error", "wrong", "waits"]]
    for row in found:
        worst = [tally["max_error"] for tally in row["checked"]]
        table.append(
            [
                f"{row['batch']} x {row['mesh']}",
                f"{row['triangles']:,}",
                str(row["resolution"]),
                f"{row['sdms_per_second']:,.4g}",
                f"{row['call']['ms']:.3g}",
                f"{row['call']['spread_percent']:.0f}",
                "-" if row["peak_mib"] is None else f"{row['peak_mib']:,.0f}",
                "not finite" if None in worst else f"{max(worst):.2f}",
                str(sum(tally["wrong_signs"] for tally in row["checked"])),
                "-"
                if "sync_error" not in row
                else row["sync_error"]
                or f"no: back after {row['returned_after_ms']:.2g} ms of {row['device_done_after_ms']:.3g}",
            ]
        )
    return table
