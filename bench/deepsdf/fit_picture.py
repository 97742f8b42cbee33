"""A picture of `sdm.bench.deepsdf fit`: what a whole map takes, and how long and how right fits are, in each way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sdm.bench.common.figure import sheet
from sdm.bench.deepsdf.beside_surrogate import SPACING_MM

WAYS = {"deepsdf": "DeepSDF", "sdmnn": "SDMNN+", "mesh": "mesh, exact"}
COLOURS = {"deepsdf": "#c9453f", "sdmnn": "#3a8a4d", "mesh": "#1f5a96"}
# Wang et al., MIDL 2020, Table 1: seconds of one map on their machine.
PUBLISHED = {"deepsdf": 28.1, "sdmnn": 0.2, "mesh": 10.7}


def is_fit(found: dict[str, Any]) -> bool:
    """True if a run has fits in all ways."""
    return set(WAYS) <= set(found.get("fits", {})) and "maps" in found


def picture(runs: dict[str, dict[str, Any]], path: Path) -> None:
    """One line for each run: times of a map, and times and errors of fits."""
    with sheet(path, (10, 3.6 * len(runs)), dpi=120, layout="constrained") as figure:
        for found, (times, fits) in zip(runs.values(), figure.subplots(len(runs), 2, squeeze=False), strict=True):
            machine = found["machine"]
            device = f"{machine['device']}, {machine['cores']} cores"
            for row, (way, name) in enumerate(WAYS.items()):
                seconds = found["maps"][f"{way}_ms"] / 1e3
                times.barh(row, seconds, color=COLOURS[way], height=0.6)
                label = f"{1e3 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"
                times.text(seconds, row, f" {label}", va="center", ha="left")
                times.plot(PUBLISHED[way], row, "D", color="none", markeredgecolor="#555555")
                fits.scatter(
                    [each["seconds"] for each in found["fits"][way]["rows"] if "seconds" in each],
                    [each["mean_mm"] for each in found["fits"][way]["rows"] if "mean_mm" in each],
                    color=COLOURS[way],
                    label=name,
                    s=45,
                )
            times.plot([], [], "D", color="none", markeredgecolor="#555555", label="Wang et al., 2020")
            times.set(title=f"One map, {device}", xlabel="seconds", xscale="log", xlim=(1e-3, 200))
            times.set_yticks(range(len(WAYS)), list(WAYS.values()))
            times.legend(fontsize="small", loc="lower right")
            fits.axhline(SPACING_MM, color="#777777", linewidth=1, linestyle="--", label="the label's voxel")
            fits.set(title="Shape fitted to a label, unseen cochleae", xlabel="seconds", xlim=(0, None))
            fits.set(ylabel="mean distance from the truth [mm]", ylim=(0, 1.1 * SPACING_MM))
            fits.legend(fontsize="small", loc="center right")
