"""Pictures of what `sdm.bench.surrogate` measured: `python -m sdm.bench.surrogate.plots [--out docs]`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from sdm.bench.common.checkout import docs_folder, results_folder
from sdm.bench.common.figure import COLOURS, OURS, drawing, log_axes, plain_ticks

MEASURES = (
    ("mae_mm", "everywhere", "#9db7d1"),
    ("mae_near_mm", "within 0.5 mm of the surface", COLOURS["Warp winding number"]),
    ("surface_mean_mm", "of the surface", COLOURS[OURS]),
)
NETWORK, ENGINE, LIBRARY = COLOURS[OURS], "#e39a8c", "#9a9a9a"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--accuracy", type=Path, default=results_folder() / "surrogate-cpu.json")
    parser.add_argument("--timing", type=Path, default=results_folder() / "surrogate-cpu.json")
    parser.add_argument("--out", type=Path, default=docs_folder())
    options = parser.parse_args()
    if options.accuracy.is_file():
        draw_accuracy(json.loads(options.accuracy.read_text())["accuracy"], options.out / "surrogate-accuracy.png")
    if options.timing.is_file():
        draw_timing(json.loads(options.timing.read_text())["timing"], options.out / "surrogate-timing.png")


def draw_accuracy(report: dict[str, Any], target: Path) -> None:
    """Mean errors of all models, and what the measure of the surface itself is off by."""
    names = list(report["models"])[::-1]
    caption = f"Means over {report['count']} shapes that no training has seen; {_machine(report)}."
    with drawing(target, caption, (12.0, 1.9 + 0.95 * len(names))) as (_, axes):
        axes.set_position((0.22, 0.24, 0.75, 0.60))
        for number, (key, label, hue) in enumerate(MEASURES):
            at = [place + 0.25 * (1 - number) for place in range(len(names))]
            values = [1e3 * report["models"][name][key] for name in names]
            axes.barh(at, values, 0.22, color=hue, label=label)
            for place, value in zip(at, values, strict=True):
                axes.text(value + 0.1, place, f"{value:.1f}" if value else "0", va="center", fontsize=10, color="0.3")
        axes.set_yticks(range(len(names)), names)
        axes.set_xlabel("mean error [µm]")
        axes.legend(loc="upper right")
        axes.margins(x=0.12)
        axes.set_title("Surrogates against exact maps of 0.2 mm voxels", x=-0.28)


def draw_timing(report: dict[str, Any], target: Path) -> None:
    """Milliseconds of one map by every method, on a logarithmic scale."""
    rows = sorted(report["rows"], key=lambda row: row["ms"], reverse=True)
    caption = (
        f"Repeated calls; {_machine(report)}, {report['threads']} cores. openvino and onnxruntime: extra onnx; "
        "SDMNN and DeepSDF are untrained, for their time; all others are checked first."
    )
    with drawing(target, caption, (12.0, 6.0)) as (_, axes):
        axes.set_position((0.22, 0.17, 0.74, 0.72))
        for place, row in enumerate(rows):
            name = row["method"]
            hue = NETWORK if name.startswith("SDMNN") else ENGINE if name == "exact engine" else LIBRARY
            axes.barh(place, row["ms"], 0.62, color=hue)
            ratio = row["libigl_ratio"]
            times = f",  {ratio:.0f} times libigl's speed" if ratio > 1.5 else ""
            axes.text(1.08 * row["ms"], place, f"{row['ms']:,.3g} ms{times}" if row["ms"] < 1e3 else
                      f"{row['ms'] / 1e3:.1f} s", va="center", fontsize=11, color="0.25")  # fmt: skip
        axes.set_yticks(range(len(rows)), [row["method"] for row in rows])
        log_axes(axes, y=False)
        plain_ticks(axes.xaxis)
        axes.set_xlim(1.0, 8 * rows[0]["ms"])
        axes.set_xlabel("milliseconds for one map of 80 x 64 x 40 voxels, from four parameters")
        axes.set_title("A cochlea's map on a CPU", x=-0.28)


def _machine(report: dict[str, Any]) -> str:
    return str(report["machine"]["device"])


if __name__ == "__main__":
    main()
