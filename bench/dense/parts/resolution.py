"""Part `resolution`: time on one mesh as the grid gets finer, the finest in slabs, which no memory need hold whole."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import load_case, missing_note
from sdm.bench.common.timing import median, once
from sdm.bench.dense.job import Job, Ours, as_dict, exponent, peak_mib, time_ours, time_peer
from sdm.bench.peers import StockWarp

MESH = "rocker-arm"
RESOLUTIONS = (32, 64, 128, 256, 512, 1024)
SLABS_FROM = 1024
SLAB_BYTES = 1 << 29


def rows(job: Job) -> Iterator[dict[str, Any]]:
    """One row for each resolution."""
    name = "torus-2000" if job.quick else "torus-20000" if missing_note(MESH) else MESH
    resolutions = (8, 16, 32) if job.quick else RESOLUTIONS if job.gpu else RESOLUTIONS[:4]
    case = load_case(name)
    ours, stock = Ours(case, job.device), StockWarp(job.device)
    stock.build(case)
    each = job.budget_s / len(resolutions) / 5
    for resolution in resolutions:
        if not job.has_time(f"{resolution}^3"):
            continue
        grid = cube_around(case, resolution)
        values = None
        if resolution >= SLABS_FROM or (job.quick and resolution == resolutions[-1]):
            most = SLAB_BYTES if not job.quick else grid.nbytes // 4

            def in_slabs(grid=grid, most=most) -> int:
                return sum(end - begin for begin, end, _ in ours.build_new().slabs(grid, most))

            first, layers = once(in_slabs, job.device)
            timing = median(in_slabs, job.device, 3, 1e3 * each)
            row = {
                "new_mesh": as_dict(timing),
                "first_ms": first,
                "mvoxels_per_second": grid.size / timing.ms / 1e3,
                "peak_mib": peak_mib(job, in_slabs),
                "slab_bytes": most,
                "layers": layers,
            }
        else:
            row, values = time_ours(job, ours, grid, each)
        row = {"mesh": name, "triangles": len(case), "resolution": resolution, **row}
        row["peers"] = [time_peer(job, stock, case, grid, values, each)]
        yield row


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Growth of the time with the number of voxels: exponents, 1 being linear, 2/3 with the surface."""
    sizes = [float(row["resolution"]) ** 3 for row in found]
    times = [row["new_mesh"]["ms"] for row in found]
    if len(times) < 2:
        return {}
    last = max(2, len(times) // 2)
    return {"exponent": exponent(sizes, times), "exponent_at_the_end": exponent(sizes[-last:], times[-last:])}


def lines(found: list[dict[str, Any]], total: dict[str, Any]) -> list[list[str]]:
    """A table to print: header first."""
    table = [["mesh", "N", "Mvoxel/s", "map ms", "± %", "peak MiB", "how", "stock ms", "of grid", "ratio"]]
    for row in found:
        stock = row["peers"][0]
        table.append(
            [
                row["mesh"],
                str(row["resolution"]),
                f"{row['mvoxels_per_second']:,.4g}",
                f"{row['new_mesh']['ms']:.3g}",
                f"{row['new_mesh']['spread_percent']:.0f}",
                "-" if row["peak_mib"] is None else f"{row['peak_mib']:,.0f}",
                "slabs" if "slab_bytes" in row else "whole",
                f"{stock['ms']:.4g}",
                f"{100 * stock['share']:.0f} %",
                f"{stock['ms'] / row['new_mesh']['ms']:.1f}",
            ]
        )
    table += [[f"{name.replace('_', ' ')} in voxels: {value:.2f} (1 is linear)"] for name, value in total.items()]
    return table
