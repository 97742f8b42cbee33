"""Figures of pages about dirty and foreign meshes and disks: page, words, record, numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from sdm.bench.suite.disk_figures import rates

README, SPEED = "README.md", "docs/speed.md"


def _zoo(record: Any, resolution: str) -> list[float]:
    found = record["summary"][resolution]
    return [found["stock_over_first"], found["slower_than_stock"]]


def _dirty(record: Any) -> list[float]:
    """Ratios of stock Warp's time to ours of a torus without some of its faces, and with half of them turned."""
    wanted = ("less 1 %", "less 3 %", "less 10 %", "less 30 %", "half its faces turned")
    rows = {row["mesh"]: row["stock_warp_ms"] / row["signed_ms"] for row in record["rows"]}
    return [next(times for mesh, times in rows.items() if mesh.startswith("torus") and name in mesh) for name in wanted]


def _lists(record: Any) -> list[float]:
    """Maps a second of each list in one call, and how many times stock Warp's better tree has."""
    rows = record["rows"]
    return [row["joint"] for row in rows] + [row["joint"] / max(row["stock_lbvh"], row["stock_sah"]) for row in rows]


README_FIGURES: tuple[tuple[str, str, str, Callable[[Any], Sequence[Any]]], ...] = (
    (README, "{} foreign meshes, open", "zoo-speed-cuda", lambda r: [r["summary"]["64"]["meshes"]]),
    (README, "{:.2f} times as fast at 64^3 ({} of them slower)", "zoo-speed-cuda", lambda r: _zoo(r, "64")),
    (README, "{:.1f} times at 256^3 ({} slower)", "zoo-speed-cuda", lambda r: _zoo(r, "256")),
    (SPEED, "of {} foreign meshes the first", "zoo-speed-cuda", lambda r: [r["summary"]["64"]["meshes"]]),
    (
        SPEED,
        "{:.2f} times as fast as stock Warp's query at 64^3, and {} are",
        "zoo-speed-cuda",
        lambda r: _zoo(r, "64"),
    ),
    (SPEED, "At 256^3 they are {:.0f} times as fast", "zoo-speed-cuda", lambda r: _zoo(r, "256")[:1]),
    (README, "{:.0f}, {:.0f}, {:.0f}, {:.0f} times as fast; {:.0f} times with half", "dirty-cuda", _dirty),
    (SPEED, "{:,.0f}, {:,.0f}, {:,.0f} maps a second: {:.0f}, {:.0f}, {:.0f} times", "ragged-cuda", _lists),
    (README, "{:.0f} meshes a second as `.npz`, {:.0f} as `.nii.gz`", "disk-cuda", rates),
)
