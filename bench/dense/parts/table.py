"""Part `table`: sdm's map, repeated for a mesh of the same size and called first, against the others' queries alone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sdm.bench.common.grids import cube_around
from sdm.bench.dense.job import Job, Ours, check_map, error_cell, geometric_mean, time_ours, time_peer, wrong_in
from sdm.bench.peers import LibiglWinding, Open3D, Peer, StockWarp, StockWarpSah, SweptVolume

MESHES = {
    "cuda": ("rocker-arm", "stanford-bunny", "nefertiti", "torus-1000000"),
    "cpu": ("rocker-arm", "nefertiti", "fandisk", "stanford-bunny"),
}
RESOLUTIONS = {"cuda": (128, 256, 512), "cpu": (64, 128)}
SMALL = {"meshes": ("torus-2000", "sphere"), "resolutions": (16, 32)}
CHECKED = 2_000


def rivals(job: Job) -> list[Peer]:
    """Whom the table is against, of those that are here; of the others it is noted why they are not."""
    on_gpu = (StockWarp, StockWarpSah, SweptVolume)
    made = [peer(job.device) for peer in on_gpu] if job.gpu else [LibiglWinding(), Open3D()]
    reasons = {peer.name: peer.missing() for peer in made}
    job.notes += [f"{reason}: the table is without it" for reason in reasons.values() if reason is not None]
    return [peer for peer in made if reasons[peer.name] is None]


def rows(job: Job, meshes: tuple[str, ...] = (), resolutions: tuple[int, ...] = ()) -> Iterator[dict[str, Any]]:
    """One row for each mesh and grid."""
    kind = "cuda" if job.gpu else "cpu"
    meshes = meshes or (SMALL["meshes"] if job.quick else MESHES[kind])
    resolutions = resolutions or (SMALL["resolutions"] if job.quick else RESOLUTIONS[kind])
    # What each row may take of the budget: the brute force and compiling need their share too.
    each = job.budget_s / (len(meshes) * len(resolutions)) / 8
    peers = rivals(job)
    for case in job.cases(meshes):
        ours = Ours(case, job.device)
        for peer in peers:
            peer.build(case)
        for resolution in resolutions:
            if not job.has_time(f"{case.name} at {resolution}^3"):
                continue
            grid = cube_around(case, resolution)
            row, values = time_ours(job, ours, grid, each)
            row = {"mesh": case.name, "triangles": len(case), "resolution": resolution, **row}
            row["checked"] = check_map(job, case, grid, values, CHECKED)
            row["closed"] = ours.index.closed
            row["peers"] = [time_peer(job, peer, case, grid, values, each) for peer in peers]
            row["ratios"] = {peer["peer"]: peer["ms"] / row["new_mesh"]["ms"] for peer in row["peers"]}
            row["ratio"] = min(row["ratios"].values(), default=None)
            yield row


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Geometric means of the ratios for each resolution, against the fastest peer on each mesh and against each."""
    means = {}
    for resolution in sorted({row["resolution"] for row in found}):
        some = [row for row in found if row["resolution"] == resolution and row["ratio"] is not None]
        if some:
            names = [n for n in some[0]["ratios"] if all(n in row["ratios"] for row in some)]
            means[str(resolution)] = {
                "meshes": len(some),
                "fastest peer": geometric_mean([row["ratio"] for row in some]),
                **{name: geometric_mean([row["ratios"][name] for row in some]) for name in names},
            }
    wrong = wrong_in(found)
    return {"geometric_means": means, "wrong": wrong}


def lines(found: list[dict[str, Any]], total: dict[str, Any]) -> list[list[str]]:
    """A table to print: header first."""
    header = ["mesh", "N", "Mvoxel/s", "map ms", "± %", "query", "build", "known faces", "peak MiB", "error", "wrong"]
    table = [[*header, "fastest peer", "its ms", "of grid", "ratio"]]
    for row in found:
        best = min(row["peers"], key=lambda p: p["ms"], default=None)
        table.append(
            [
                row["mesh"],
                str(row["resolution"]),
                f"{row['mvoxels_per_second']:,.4g}",
                f"{row['new_mesh']['ms']:.3g}",
                f"{row['new_mesh']['spread_percent']:.0f}",
                f"{row['query']['ms']:.3g}",
                f"{row['build_new']['ms']:.3g}",
                f"{row['build']['ms']:.3g}",
                "-" if row["peak_mib"] is None else f"{row['peak_mib']:,.0f}",
                error_cell(row),
                str(row["checked"]["wrong_signs"]),
                *(["-"] * 4 if best is None else [best["peer"], f"{best['ms']:.4g}", f"{100 * best['share']:.0f} %"]),
                *([] if best is None else [f"{row['ratio']:.1f}"]),
            ]
        )
    for resolution, means in total["geometric_means"].items():
        names = ", ".join(f"{name} {value:.1f}" for name, value in means.items() if name != "meshes")
        table.append([f"geometric mean at {resolution}^3 over {means['meshes']} meshes: {names}"])
    return table
