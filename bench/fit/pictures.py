"""Pictures of the fit for docs/: a simulated case, the real shape, and the coverage of the intervals."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

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

# As in the other figures.
HEADLINE: dict[str, Any] = {"loc": "left", "fontweight": "bold"}


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
