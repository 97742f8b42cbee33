"""Part `graph`: a batch of maps captured in a CUDA graph, replayed with other vertices, against the plain call."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch

import sdm
from sdm.bench.common.timing import median
from sdm.bench.dense.job import Job, as_dict, recorded
from sdm.bench.dense.parts.batch import BATCHES, GRID, RESOLUTION, family
from sdm.runtime import graphs


def rows(job: Job) -> Iterator[dict[str, Any]]:
    """One row for each size of batch; `captured` says whether it worked, `why_not` what torch or Warp said if not."""
    if not job.gpu:
        job.notes.append("CUDA graphs need a GPU")
        return
    resolution = 16 if job.quick else RESOLUTION
    step = (GRID[1] - GRID[0]) / (resolution - 1)
    grid = sdm.Grid((GRID[0],) * 3, (step,) * 3, (resolution,) * 3)
    for batch in (2,) if job.quick else BATCHES:
        name, vertices, faces = family(job, batch)
        at, shared = torch.from_numpy(vertices).to(job.device), torch.from_numpy(faces).to(job.device)
        other = at.flip(0).contiguous()
        row = {"mesh": name, "batch": batch, "resolution": resolution}
        with graphs.paused():
            expected = sdm.signed_distance_maps(other, shared, grid)
            plain = median(lambda a=at, s=shared: sdm.signed_distance_maps(a, s, grid), job.device, 3 * job.runs, 1e3)
        row["plain"] = as_dict(plain)
        try:
            again, values = recorded(lambda a=at, s=shared: sdm.signed_distance_maps(a, s, grid))
            at.copy_(other)
            again()
            torch.cuda.synchronize()
        except Exception as error:  # noqa: BLE001 - whatever torch or Warp says is the result here
            # What failed in a capture may leave the stream unusable: nothing more is tried.
            yield row | {"captured": False, "why_not": f"{type(error).__name__}: {error}".split("\n", maxsplit=1)[0]}
            return
        same = bool(torch.equal(values, expected))
        largest = float((values - expected).abs().max())
        timing = median(again, job.device, 3 * job.runs, 1e3)
        yield row | {
            "captured": True,
            "replay": as_dict(timing),
            "sdms_per_second": 1e3 * batch / timing.ms,
            "same_bits": same,
            "largest_difference": largest,
        }


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """True if every capture worked and its replay gave the plain call's maps to 4 roundings."""
    return {"captured": bool(found) and all(r["captured"] and r["largest_difference"] < 5e-7 for r in found)}


def lines(found: list[dict[str, Any]], total: dict[str, Any]) -> list[list[str]]:
    """A table to print: header first."""
    table = [["meshes", "N", "captured", "plain ms", "replay ms", "SDM/s", "largest difference"]]
    for row in found:
        table.append([f"{row['batch']} x {row['mesh']}", str(row["resolution"])])
        if row["captured"]:
            figures = [f"{row['plain']['ms']:.3g}", f"{row['replay']['ms']:.3g}", f"{row['sdms_per_second']:,.4g}"]
            table[-1] += ["yes", *figures, f"{row['largest_difference']:.1e}"]
        else:
            table[-1] += ["no", f"{row['plain']['ms']:.3g}", "-", "-", row["why_not"]]
    return table
