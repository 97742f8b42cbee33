"""Rows of public tables, made again from the records that they come from: for `sdm.bench.suite.page_figures`."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

from sdm.bench.common.checkout import results_folder

# The papers' left-atrium study, in the order of the page.
PATCHES, WHOLE = "## Left atrium (Ma et al.)", "### Whole volumes: a patch holds nearly all of one"
RUNS = ("atria-local", "atria-published", "cochlea-local", "cochlea-published")
METHODS = {
    "SDMNN+, openvino": "SDMNN+, OpenVINO",
    "SDMNN+, onnxruntime": "SDMNN+, ONNX Runtime",
    "SDMNN+, torch": "SDMNN+, torch",
    "exact engine": "our exact engine, from the mesh",
    "libigl pseudonormal": "libigl, the quicker of its two signs",
    "stock Warp": "stock Warp",
}


def _record(name: str) -> Any:
    return json.loads((results_folder() / f"{name}.json").read_text())


def _methods_of(heading: str) -> dict[str, tuple[list[str], str]]:
    """The first four figures of each method, and its seeds, of the first table below a heading of segmentation.md."""
    report = (results_folder() / "segmentation.md").read_text()
    table = report.split(f"\n{heading}", 1)[1].split("Largest connected component", 1)[1].split("\n\n")[1]
    rows = re.findall(r"^\| ([\w-]+) \((\d+)\) \| (.*) \|$", table, re.MULTILINE)
    return {name: ([cell.split(" ")[0] for cell in cells.split(" | ")][:4], seeds) for name, seeds, cells in rows}


def left_atrium() -> list[str]:
    """Ma et al.: each method by whole volumes and by patches."""
    whole, patches = _methods_of(WHOLE), _methods_of(PATCHES)
    left_out = {"hausdorff-foreground", "pwr"}
    cells = {name: [f"{', '.join(part[name][0])} ({part[name][1]})" for part in (whole, patches)] for name in whole}
    return [f"| `{name}` | {' | '.join(both)} |" for name, both in cells.items() if name not in left_out]


def deepsdf_scores() -> list[str]:
    """Chamfer distances, distances and Dice of the unseen shapes of each run."""
    rows = []
    for run in RUNS:
        found = _record("deepsdf")[run]["unseen"]
        of, digits = found["mean"], 3 if run.startswith("cochlea") else 2 if "published" in run else 3
        chamfer = [f"{of[key]:.3f}" for key in ("chamfer_paper", "chamfer_paper_floor", "chamfer", "chamfer_floor")]
        far = f"{of['mean_mm']:.{digits}f} ({of['percentile95_mm']:.{digits}f})"
        seconds = f"{found['seconds_a_shape']:.2g} s" if "published" in run else f"{found['seconds_a_shape']:.2f} s"
        shown = "{} ({}); {} ({})".format(*chamfer)
        rows.append(f"{shown} | {far} | {of['dice']:.3f} | {seconds} |")
    return rows


def surrogate_times() -> list[str]:
    """Milliseconds of one map and times of libigl's speed."""
    found = {row["method"]: row for row in _record("surrogate-cpu")["timing"]["rows"]}
    rows = []
    for method, name in METHODS.items():
        ms, ratio = found[method]["ms"], found[method]["libigl_ratio"]
        times = f"{ratio:.1f}" if ratio < 1 else f"{ratio:.0f}"
        rows.append(f"| {name} | {ms:.1f} | {times} |" if ms < 10 else f"| {name} | {ms:.0f} | {times} |")
    return rows


def fit_times() -> list[str]:
    """Seconds of a fit, and how many times as fast as libigl's."""
    summary = _record("fit-cases")["summary"]
    ours = ("exact", "surrogate", "hybrid")
    keys = ("median_seconds", "times_faster_than_libigl", "times_faster_than_libigl-map")
    return ["| {} | {:.1f} | {} | {} |".format(name, *(summary[name][key] for key in keys)) for name in ours]


def dataset_costs() -> list[str]:
    """Disk and time of 100,000 maps, by the rates of each record."""
    rows, maps = [], 100_000
    sizes = {row["maps"]: row["mb_each"] for row in _record("disk-shards-cpu")["rows"]}
    for work in ("float16 none", "float32 zstd"):
        memory, disk, cores = (
            next(row for row in _record(name)["pipelines"] if row["work"] == f"generate {work}")
            for name in ("disk-generate-cuda", "disk-real-cuda", "disk-cpu")
        )
        size, seconds = (
            maps * sizes[work] / 1000,
            [maps / row.get("steady_per_second", row["per_second"]) for row in (memory, disk, cores)],
        )
        rows.append(f"| {size:.0f} GB | {seconds[0]:.0f} s | {seconds[1]:.0f} s | {seconds[2] / 3600:.1f} h |")
    return rows


TABLES: tuple[tuple[str, str, Callable[[], list[str]]], ...] = (
    ("docs/papers.md", "segmentation.md", left_atrium),
    ("sdm/deepsdf/README.md", "deepsdf", deepsdf_scores),
    ("sdm/surrogate/README.md", "surrogate-cpu", surrogate_times),
    ("sdm/fit/README.md", "fit-cases", fit_times),
    ("docs/from-disk-to-disk.md", "disk-*", dataset_costs),
)
