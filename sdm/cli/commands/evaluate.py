"""`sdm evaluate`: segmentations against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import print_line, printable


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
    symmetric surface distance. An empty prediction is a failure: overlap 0, distances infinite; it is left out of the
    means of distances, and counted there. Where both labels are empty nothing can be said, and no mean has the case. Of
    a folder, truths without a prediction are named.

    Args:
        predictions: A NIfTI label, or a folder of them; files that end in _sdm are not looked at.
        truths: The true label, or a folder with labels of the same names (NIfTI, or HDF5 with a data set label).
        json: File for the scores of every case; what is infinite or unknown is null.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    import math
    from json import dumps

    from sdm.cli.common.inputs import refuse_inputs
    from sdm.core.device import choose_device
    from sdm.io.files.atomic import replacing
    from sdm.io.maps.formats import check_file
    from sdm.segmentation import scores_of, table
    from sdm.segmentation.data.pairs import label_pairs, labels_of
    from sdm.segmentation.infer.scores import COLUMNS

    # Not only those that have a partner: what lies with labels may well be one.
    known = labels_of(truths)
    refuse_inputs([json], [*labels_of(predictions).values(), *known.values()])
    if json is not None:
        check_file(json)
    where = choose_device(device)
    scores = {
        name: scores_of(prediction.to(where), truth.to(where), spacing)
        for name, prediction, truth, spacing in label_pairs(predictions, truths)
    }
    rows = {printable(name): [case] for name, case in scores.items()}
    print(table({**rows, f"mean of {len(rows)}": list(scores.values())} if len(rows) > 1 else rows, list(COLUMNS)))
    if json is not None:
        with replacing(json) as part:
            # JSON has no word for infinite.
            plain = {
                name: {key: value if math.isfinite(value) else None for key, value in case.items()}
                for name, case in scores.items()
            }
            part.write_text(dumps(plain, indent=1, allow_nan=False) + "\n")
    failed = [name for name, case in scores.items() if case["failed"]]
    if failed:
        print_line(f"failed, for one of the two labels is empty: {', '.join(failed)}")
    nothing = [name for name, case in scores.items() if math.isnan(case["dice"])]
    if nothing:
        print_line(f"in no mean, for both labels are empty: {', '.join(nothing)}")
    forgotten = sorted({*known} - {*scores}) if predictions.is_dir() else []
    if forgotten:
        print_line(f"in no mean, for nothing was predicted: {', '.join(forgotten)}")
    return None
