"""Pictures of the fit for docs/: a simulated case, the real shape, and the coverage of the intervals."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from sdm import SDMError
from sdm.bench.common.checkout import results_folder
from sdm.bench.common.figure import sheet
from sdm.bench.fit.real import real_mesh, scan
from sdm.bench.fit.tools import backends_by_name, case, fit_case, truth_backend
from sdm.fit import SCANNERS
from sdm.viz.fit_figure import draw_fit
from sdm.viz.style import BLUE, RED

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def pictures(options: argparse.Namespace) -> None:
    """Draw docs/fit-simulated.png, docs/fit-real.png and docs/fit-coverage.png, each if its data are there."""
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
    record = results_folder() / "fit-coverage.json"
    if record.is_file():
        _coverage(json.loads(record.read_text()), options.docs / "fit-coverage.png")
    studies(options.docs)


def studies(docs: Path) -> None:
    """Draw the pictures of `formation` and `refusals` from their records, each if it is there."""
    for name, draw in (("formation", _formation), ("refusals", _refusals)):
        record = results_folder() / f"fit-{name}.json"
        if record.is_file():
            draw(json.loads(record.read_text()), docs / f"fit-{name}.png")


def _formation(record: dict, path: Path) -> None:
    """Coverage before and after the formation is estimated, by condition."""
    with sheet(path, (8, 4), dpi=110, layout="constrained") as figure:
        panel = figure.subplots()
        found = {name: row for name, row in record["conditions"].items() if row.get("coverage_90_shape") is not None}
        panel.axhspan(0.87, 0.93, color="0.9")
        panel.axhline(0.9, color="0.5", linewidth=0.8)
        places = range(len(found))
        after = [row["coverage_90_shape"] for row in found.values()]
        errors = [1.96 * row.get("standard_error_shape", 0) for row in found.values()]
        panel.errorbar(places, after, yerr=errors, fmt="o", color=BLUE, capsize=2, label="formation estimated")
        before = [row.get("coverage_90_shape_before", float("nan")) for row in found.values()]
        panel.plot(places, before, "x", color=RED, label="all taken for granted")
        panel.set_xticks(places, [f"{name}\n{row['trusted']} fits" for name, row in found.items()])
        panel.set_ylim(0.0, 1.02)
        panel.set_ylabel("90 % intervals that hold the truth")
        panel.set_title("Simulated cochleae at 0.3 mm; the fit is told a blur of 0.2 mm")
        panel.legend()


def _refusals(record: dict, path: Path) -> None:
    """Images with an answer, and those of them that are refused, by noise."""
    with sheet(path, (7, 3.5), dpi=110, layout="constrained") as figure:
        panel = figure.subplots()
        rows = record["by_noise"]
        places = range(len(rows))
        panel.bar(places, [r["images"] for r in rows], color="0.85", label="images with an answer")
        panel.bar([i - 0.2 for i in places], [r["refused_plain"] for r in rows], 0.4, color=RED,
                  label="refused, all taken for granted")  # fmt: skip
        panel.bar([i + 0.2 for i in places], [r["refused"] for r in rows], 0.4, color=BLUE,
                  label="refused, formation estimated")  # fmt: skip
        panel.set_xticks(places, [f"{r['noise_HU']:g}" for r in rows])
        panel.set_xlabel("noise [HU] at a contrast of 1600 HU")
        panel.set_title("Voxels of 0.15 to 0.6 mm, blur of 0.1 to 0.4 mm")
        panel.legend(fontsize=8)


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
    panel.set_title("Simulated shapes that fit the model: family, blur and noise are the fit's own")
    panel.legend()
