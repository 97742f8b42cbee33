"""`sdm evaluate`: segmentations against the truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import print_line, printable

if TYPE_CHECKING:
    from sdm.segmentation import LabelScores


def evaluate(
    predictions: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PREDICTIONS")],
    truths: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TRUTHS")],
    /,
    *,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None,
    device: Device = "auto",
) -> int | None:
    """Score predicted labels against true ones: overlap in percent, distances between the surfaces in mm.

    Dice, Jaccard, Dice near the contour (5 voxels), 95 percent Hausdorff distance, average and root mean square
    symmetric surface distance. Where both labels have several classes, each class is scored, and then their mean; in a
    folder that has one such case all cases are. Otherwise all that is not 0 is one foreground.

    An empty prediction is a failure, and so is a class that is in one of the two labels alone: overlap 0, distances
    infinite; it is left out of the means of distances, and counted there. What both labels lack is in no mean. Of a
    folder, truths without a prediction are named.

    Args:
        predictions: A NIfTI label, or a folder of them; files that end in _sdm are not looked at.
        truths: The true label, or a folder with labels of the same names (NIfTI, or HDF5 with a data set label).
        json: File for the scores of every case, of several classes their means and, below "classes", each; what is
            infinite or unknown is null.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    import math
    from json import dumps

    from sdm.cli.common.inputs import refuse_inputs
    from sdm.core.device import choose_device
    from sdm.io.files.atomic import replacing
    from sdm.io.maps.formats import check_file
    from sdm.segmentation import score_labels, table
    from sdm.segmentation.data.pairs import labels_of
    from sdm.segmentation.infer.scores import COLUMNS

    # Not only those that have a partner: what lies with labels may well be one.
    known = labels_of(truths)
    refuse_inputs([json], [*labels_of(predictions).values(), *known.values()])
    if json is not None:
        check_file(json)
    scores = score_labels(predictions, truths, choose_device(device))
    print(table(_rows(scores), list(COLUMNS)))
    if json is not None:
        with replacing(json) as part:
            part.write_text(dumps(_plain(scores), indent=1, allow_nan=False) + "\n")
    if scores.classes is None:
        failed = [name for name, case in scores.cases.items() if case["failed"]]
        if failed:
            print_line(f"failed, for one of the two labels is empty: {', '.join(failed)}")
    for side, alone in (("prediction", scores.predicted_alone), ("truth", scores.missed)):
        if alone:
            several = len(scores.cases) > 1
            named = ", ".join(f"{name}, class {value}" if several else f"class {value}" for name, value in alone)
            print_line(f"failed, for the {side} alone has it: {named}")
    nothing = [name for name, case in scores.cases.items() if math.isnan(case["dice"])]
    if nothing:
        print_line(f"in no mean, for both labels are empty: {', '.join(nothing)}")
    forgotten = sorted({*known} - {*scores.cases}) if predictions.is_dir() else []
    if forgotten:
        print_line(f"in no mean, for nothing was predicted: {', '.join(forgotten)}")
    return None


def _rows(scores: LabelScores) -> dict[str, list[dict[str, float | bool]]]:
    """Rows of the table: each case and the mean; or each class of each case, its mean, and the mean of these."""
    from sdm.segmentation.infer.scores import mean_of

    names = {name: printable(name) for name in scores.cases}
    if scores.classes is None:
        rows = {names[name]: [case] for name, case in scores.cases.items()}
        return {**rows, f"mean of {len(rows)}": list(scores.cases.values())} if len(rows) > 1 else rows
    values = sorted({value for case in scores.classes.values() for value in case})
    if len(names) == 1:
        (case,) = scores.classes.values()
        return {
            **{f"class {value}": [case[value]] for value in values},
            f"mean of {len(values)} classes": [*case.values()],
        }
    rows = {
        f"{names[name]}, class {value}": [found]
        for name, case in scores.classes.items()
        for value, found in case.items()
    }
    of_class = {value: [case[value] for case in scores.classes.values() if value in case] for value in values}
    rows |= {f"class {value}, mean of {len(found)}": found for value, found in of_class.items()}
    return {**rows, f"mean of {len(values)} classes": [mean_of(found) for found in of_class.values()]}


def _plain(scores: LabelScores) -> dict[str, dict]:
    """The scores for JSON, which has no word for infinite."""
    import math

    def finite(case: Mapping[str, float | bool]) -> dict:
        return {key: value if math.isfinite(value) else None for key, value in case.items()}

    if scores.classes is None:
        return {name: finite(case) for name, case in scores.cases.items()}
    return {
        name: {**finite(case), "classes": {str(v): finite(found) for v, found in scores.classes[name].items()}}
        for name, case in scores.cases.items()
    }
