"""Pictures of what `bench.surrogate` measured: `python -m bench.surrogate_plots [--out docs]`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

RESULTS = Path("bench/results")
MEASURES = (("mae_mm", "everywhere"), ("mae_near_mm", "within 0.5 mm of the surface"), ("surface_mean_mm", "surface"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--accuracy", type=Path, default=RESULTS / "surrogate-cuda.json")
    parser.add_argument("--timing", type=Path, default=RESULTS / "surrogate-cpu.json")
    parser.add_argument("--out", type=Path, default=Path("docs"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.accuracy.is_file():
        report = json.loads(options.accuracy.read_text())["accuracy"]
        draw_accuracy(report, options.out / "surrogate-accuracy.png")
    if options.timing.is_file():
        report = json.loads(options.timing.read_text())["timing"]
        draw_timing(report, options.out / "surrogate-timing.png")


def draw_accuracy(report: dict[str, Any], target: Path) -> None:
    """Mean errors of all models beside each other, on a logarithmic scale."""
    figure = _figure(9.0, 4.5)
    axes = figure.add_subplot()
    names = list(report["models"])
    for number, (key, label) in enumerate(MEASURES):
        heights = [max(report["models"][name][key], 1e-4) for name in names]
        axes.bar([x + 0.27 * (number - 1) for x in range(len(names))], heights, 0.25, label=label)
    axes.set_yscale("log")
    axes.set_ylabel("mean error [mm]")
    axes.set_xticks(range(len(names)), names, rotation=20, ha="right")
    axes.set_title(f"Surrogates against exact maps, {report['count']} shapes ({report['machine']['device']})")
    axes.legend(frameon=False)
    axes.grid(axis="y", alpha=0.3)
    figure.tight_layout()
    figure.savefig(target, dpi=120)
    print(target)


def draw_timing(report: dict[str, Any], target: Path) -> None:
    """Milliseconds of one map by every method, on a logarithmic scale."""
    figure = _figure(9.0, 4.5)
    axes = figure.add_subplot()
    rows = sorted(report["rows"], key=lambda row: row["ms"], reverse=True)
    axes.barh([row["method"] for row in rows], [row["ms"] for row in rows], color="#3f86bd")
    for place, row in enumerate(rows):
        axes.text(row["ms"], place, f" {row['ms']:.3g} ms", va="center")
    axes.set_xscale("log")
    axes.set_xlabel("milliseconds for one map, from four parameters")
    machine = report["machine"]
    axes.set_title(f"{machine['device']}, {report['threads']} threads")
    axes.margins(x=0.15)
    figure.tight_layout()
    figure.savefig(target, dpi=120)
    print(target)


def _figure(width: float, height: float) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), facecolor="white")
    FigureCanvasAgg(figure)
    return figure


if __name__ == "__main__":
    main()
