"""Picture of `sdm.bench.surrogate.error_time`: python -m sdm.bench.surrogate.error_time_figure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sdm.bench.common.checkout import docs_folder, results_folder
from sdm.bench.common.figure import COLOURS, OURS, drawing, log_axes

HUES = {
    "SDMNN+": COLOURS[OURS],
    "exact engine": "#e39a8c",
    "POD + Chebyshev": "#9db7d1",
    "libigl winding number": COLOURS["libigl winding number"],
    "libigl pseudonormal": COLOURS["libigl pseudonormal"],
}
# Where an error of zero is drawn: below all others.
ZERO = 3.0
# Of points whose errors differ by less than this share, the lowest has a name.
SAME = 0.1


def draw(record: dict[str, Any], target: Path) -> None:
    """Error near the surface against the time of one map, both logarithmic."""
    rows = record["rows"]
    floor = min(row["mae_near_mm"] for row in rows if row["mae_near_mm"] > 1e-6) / ZERO
    caption = (
        f"Repeated calls of all methods by turns, medians of processor time on one core; {record['shapes']} shapes "
        f"that no training has seen. {record['machine']['device']}. Lowest line: no error but float32's."
    )
    with drawing(target, caption, (12.0, 7.0)) as (_, axes):
        axes.set_position((0.10, 0.17, 0.83, 0.73))
        for method, hue in HUES.items():
            own = [row for row in rows if row["method"] == method]
            if not own:
                continue
            x, y = [row["ms"] for row in own], [max(row["mae_near_mm"], floor) for row in own]
            line = "-" if len({row["mae_near_mm"] for row in own}) > 2 else ""
            axes.plot(x, y, line, marker="o", color=hue, label=method)
            if method == "libigl winding number":
                # Its neighbour's labels are its own.
                continue
            for row, a, b in zip(own, x, y, strict=True):
                if any((1 - SAME) * b < other < b for other in y):
                    # Names of two meshes that are as near would lie on each other.
                    continue
                axes.annotate(
                    row["of"], (a, b), textcoords="offset points", fontsize=8, color="0.35", **_place(method, row["of"])
                )
        log_axes(axes)
        axes.set_xlabel("milliseconds of one core for one map of 80 x 64 x 40 voxels, from four parameters")
        axes.set_ylabel("mean error within 0.5 mm of the surface [mm]")
        axes.legend(loc="lower left")
        axes.set_title("A cochlea's map: error against time", x=0.0, ha="left")


def _place(method: str, name: str) -> dict[str, Any]:
    """Place of a point's name, clear of curves and of other names."""
    if method.startswith("libigl"):
        return {"xytext": (-8, -3), "ha": "right"}
    if name in ("32 modes", "64 modes", "128 modes", "torch", "onnxruntime"):
        return {"xytext": (0, -14), "ha": "center"}
    return {"xytext": (7, 5)}


if __name__ == "__main__":
    draw(
        json.loads((results_folder() / "surrogate-error-time.json").read_text()),
        docs_folder() / "surrogate-error-time.png",
    )
