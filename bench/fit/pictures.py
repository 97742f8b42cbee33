"""Pictures of the fit for docs/: a simulated case, the real shape, coverage of the intervals, and refusals."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sdm import SDMError
from sdm.bench.common.checkout import results_folder
from sdm.bench.common.figure import sheet
from sdm.bench.fit.coverage import LEVEL_SIGMAS
from sdm.bench.fit.real import real_mesh, scan
from sdm.bench.fit.tools import backends_by_name, case, fit_case, truth_backend
from sdm.fit import SCANNERS
from sdm.viz.fit_figure import draw_fit
from sdm.viz.style import BLUE, RED

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHORT = {
    "matched": "as told",
    "blur": "blur 0.3, not 0.2",
    "correlated": "correlated noise",
    "shading": "shading",
    "thick": "thick slices",
    "turned": "turned to 90°",
}
# As in the other figures.
HEADLINE: dict[str, Any] = {"loc": "left", "fontweight": "bold"}


def pictures(options: argparse.Namespace) -> None:
    """Draw docs/fit-simulated.png, fit-real.png, fit-coverage.png and fit-formation.png, each if its data are there.

    With `records` alone those that need no fit.
    """
    _of_records(options.docs)
    if options.records:
        return
    backends = backends_by_name("exact", options.device)
    image = case(truth_backend(), "0.3", 1000, edge=0.1)[1]
    result = fit_case(image, "0.3", backends)
    title = "A simulated cochlea at 0.3 mm: image, fit, what is left over"
    draw_fit(image.values, image.grid, backends[0], result, options.docs / "fit-simulated.png", title=title)
    try:
        image = scan(real_mesh(None), SCANNERS["0.2"], seed=7)
    except SDMError as error:
        print(f"no picture of the real shape: {error}")
    else:
        result = fit_case(image, "0.2", backends)
        title = "The mean human scala tympani, scanned at 0.2 mm"
        draw_fit(image.values, image.grid, backends[0], result, options.docs / "fit-real.png", title=title)


def _of_records(docs: Path) -> None:
    found = {name: results_folder() / f"fit-{name}.json" for name in ("coverage", "formation", "refusals")}
    read = {name: json.loads(path.read_text()) for name, path in found.items() if path.is_file()}
    if "coverage" in read:
        _coverage(read["coverage"], docs / "fit-coverage.png")
    if "formation" in read and "refusals" in read:
        with sheet(docs / "fit-formation.png", (12, 4.8), dpi=110, layout="constrained") as figure:
            one, two = figure.subplots(1, 2)
            draw_formation(read["formation"], one)
            draw_refusals(read["refusals"], two)


def draw_formation(record: dict[str, Any], panel: Axes) -> None:
    """Coverage under each condition, with the image's formation estimated (95 % of what chance does) and without."""
    conditions = record["conditions"]
    found = conditions.values()
    panel.axhline(0.9, color="0.5", linewidth=0.8)
    before = [each["coverage_90_shape_before"] for each in found]
    panel.plot([i + 0.1 for i in range(len(before))], before, "s", color=BLUE, label="not estimated")
    errors = [1.96 * each["standard_error_shape"] for each in found]
    values = [each["coverage_90_shape"] for each in found]
    places = [i - 0.1 for i in range(len(values))]
    panel.errorbar(places, values, yerr=errors, fmt="o", color=RED, label="formation estimated", capsize=2)
    panel.set_xticks(range(len(values)), [SHORT[name] for name in conditions], rotation=30, ha="right")
    panel.set_ylim(0.4, 1.0)
    panel.set_ylabel("90 % intervals that hold the truth")
    panel.set_title(f"{max(each['cases'] for each in found)} shapes, each imaged in six ways", **HEADLINE)
    panel.legend(loc="lower right")


def draw_refusals(record: dict[str, Any], panel: Axes) -> None:
    """Coverage over noise, of images of many voxel sizes and blurs, and how many were refused."""
    rows = record["by_noise"]
    panel.axhline(0.9, color="0.5", linewidth=0.8)
    values = [row["coverage_90_shape"] for row in rows]
    panel.errorbar(range(len(rows)), values, yerr=_chance(record), fmt="o", color=RED, capsize=2)
    panel.set_xticks(range(len(rows)), [f"{row['noise_HU']:.0f}" for row in rows])
    panel.set_ylim(0.8, 1.0)
    panel.set_xlabel("noise [HU], contrast 1600")
    panel.set_title(f"{record['images']} images, voxels of 0.15 to 0.6 mm: {record['refused']} refused", **HEADLINE)


def _chance(record: dict[str, Any]) -> list[float]:
    """95 % of what chance does to the coverage of each noise, from image to image."""
    errors = []
    for row in record["by_noise"]:
        own = [case["z"][:4] for case in record["cases"] if case["noise"] == row["noise_HU"] and case["trusted"]]
        held = (np.abs(own) <= LEVEL_SIGMAS).mean(1)
        errors.append(1.96 * float(held.std()) / len(held) ** 0.5)
    return errors


def _coverage(record: dict, path: Path) -> None:
    with sheet(path, (9, 4.5), dpi=110, layout="constrained") as figure:
        _draw_coverage(record, figure.subplots())


def _draw_coverage(record: dict, panel: Axes) -> None:
    panel.axhline(0.9, color="0.5", linewidth=0.8)
    for offset, scanner, colour in ((-0.12, "0.3", BLUE), (0.12, "0.2", RED)):
        found = record[scanner]
        if not found["trusted"]:
            continue
        values = list(found["coverage_90"].values())
        error = 1.96 * found["standard_error_of_one"]
        places = [i + offset for i in range(len(values))]
        label = f"{scanner} mm, {found['trusted']} cases"
        panel.errorbar(places, values, yerr=error, fmt="o", color=colour, label=label, capsize=2)
        panel.set_xticks(range(len(values)), list(found["coverage_90"]), rotation=30)
    panel.set_ylim(0.7, 1.0)
    panel.set_ylabel("90 % intervals that hold the truth")
    panel.set_title("Simulated shapes that fit the model: family, blur and noise are the fit's own", **HEADLINE)
    panel.legend()
