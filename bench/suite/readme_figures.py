"""Figures of pages about dirty and foreign meshes and disks: page, words, record, numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import geometric_mean
from typing import Any

from sdm.bench.suite.disk_figures import rates

README, SPEED = "README.md", "docs/speed.md"
# Of the foreign meshes, those that the newer record leaves out.
LEFT_OUT = ".zae"


def _zoo(record: Any, resolution: str) -> list[float]:
    found = record["summary"][resolution]
    return [found["stock_over_first"], found["slower_than_stock"]]


def _zoo_of_fewer(record: Any) -> list[float]:
    rows = [row for row in record["rows"] if row["resolution"] == 64 and not row["mesh"].endswith(LEFT_OUT)]
    return [geometric_mean(row["stock_over_first"] for row in rows)]


def _dirty(record: Any) -> list[float]:
    """Ratios of stock Warp's time to ours of a torus without some of its faces, and with half of them turned."""
    wanted = ("less 1 %", "less 3 %", "less 10 %", "less 30 %", "half its faces turned")
    rows = {row["mesh"]: row["stock_warp_ms"] / row["signed_ms"] for row in record["rows"]}
    return [next(times for mesh, times in rows.items() if mesh.startswith("torus") and name in mesh) for name in wanted]


README_FIGURES: tuple[tuple[str, str, str, Callable[[Any], Sequence[Any]]], ...] = (
    (README, "{} foreign meshes, open", "zoo-speed-cuda", lambda r: [r["summary"]["64"]["meshes"]]),
    (README, "{:.2f} times as fast at 64^3 ({} of them slower)", "zoo-speed-cuda", lambda r: _zoo(r, "64")),
    (README, "{:.1f} times at 256^3 ({} slower)", "zoo-speed-cuda", lambda r: _zoo(r, "256")),
    (SPEED, "Of {} of them", "zoo-speed-64-h100", lambda r: [r["summary"]["64"]["meshes"]]),
    (SPEED, "newer engine takes {:.2f} times at 64^3", "zoo-speed-64-h100", lambda r: _zoo(r, "64")),
    (SPEED, "where it was {:.2f} (", "zoo-speed-cuda", _zoo_of_fewer),
    (SPEED, "zoo-speed-64-h100.json)); {1} are slower", "zoo-speed-64-h100", lambda r: _zoo(r, "64")),
    (README, "{:.0f}, {:.0f}, {:.0f}, {:.0f} times as fast; {:.0f} times with half", "dirty-cuda", _dirty),
    (README, "{:.0f} meshes a second as `.npz`, {:.0f} as `.nii.gz`", "disk-cuda", rates),
)
