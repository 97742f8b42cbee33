"""Part `triangles`: time on one grid as the mesh gets finer, from a thousand triangles to five million."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sdm.bench.common.grids import cube_around
from sdm.bench.common.meshes import load_case
from sdm.bench.dense.job import Job, Ours, check_map, exponent, time_ours, time_peer
from sdm.bench.peers import StockWarp

COUNTS = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 5_000_000)
RESOLUTION = 256
CHECKED = 500
# The brute force alone takes seconds beyond this.
MOST_CHECKED = 1_500_000


def rows(job: Job) -> Iterator[dict[str, Any]]:
    """One row for each number of triangles of a torus."""
    counts = (100, 1_000, 4_000) if job.quick else COUNTS if job.gpu else COUNTS[:5]
    resolution = 24 if job.quick else RESOLUTION if job.gpu else 64
    for wanted in counts:
        if not job.has_time(f"a torus of {wanted:,} triangles"):
            continue
        case = load_case(f"torus-{wanted}")
        grid = cube_around(case, resolution)
        row, values = time_ours(job, Ours(case, job.device), grid, job.budget_s / len(counts) / 6)
        row = {"mesh": case.name, "triangles": len(case), "resolution": resolution, **row}
        if len(case) <= MOST_CHECKED:
            row["checked"] = check_map(job, case, grid, values, CHECKED)
        stock = StockWarp(job.device)
        stock.build(case)
        row["peers"] = [time_peer(job, stock, case, grid, values, job.budget_s / len(counts) / 6)]
        yield row


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Growth of the time with the number of triangles: exponents, 1 being linear; over all, and over the last third."""
    sizes = [float(row["triangles"]) for row in found]
    result = {}
    for name in ("new_mesh", "query", "build_new"):
        times = [row[name]["ms"] for row in found]
        if len(times) > 1:
            result[f"{name}_exponent"] = exponent(sizes, times)
            last = max(2, len(times) // 3)
            result[f"{name}_exponent_at_the_end"] = exponent(sizes[-last:], times[-last:])
    return result


def lines(found: list[dict[str, Any]], total: dict[str, Any]) -> list[list[str]]:
    """A table to print: header first."""
    table = [["triangles", "N", "map ms", "± %", "query", "build", "peak MiB", "error", "wrong", "stock ms", "ratio"]]
    for row in found:
        tally = row.get("checked")
        stock = row["peers"][0]["ms"]
        table.append(
            [
                f"{row['triangles']:,}",
                str(row["resolution"]),
                f"{row['new_mesh']['ms']:.3g}",
                f"{row['new_mesh']['spread_percent']:.0f}",
                f"{row['query']['ms']:.3g}",
                f"{row['build_new']['ms']:.3g}",
                "-" if row["peak_mib"] is None else f"{row['peak_mib']:,.0f}",
                "-" if tally is None or tally["max_error"] is None else f"{tally['max_error']:.2f}",
                "-" if tally is None else str(tally["wrong_signs"]),
                f"{stock:.4g}",
                f"{stock / row['new_mesh']['ms']:.1f}",
            ]
        )
    table += [[f"{name.replace('_', ' ')}: {value:.2f} (1 is linear)"] for name, value in total.items()]
    return table
