"""Scores of files of labels: of the foreground, or class by class."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from sdm.metrics.surface_voxels import foreground_box
from sdm.segmentation.data.pairs import LabelPair, label_pairs, warn_of_classes
from sdm.segmentation.infer.scores import mean_of, scores_of

# Voxels around a class that its scores ask for: half the cube of the contour's Dice.
AROUND = 2

Scores = dict[str, float | bool]


@dataclass(frozen=True, kw_only=True)
class LabelScores:
    """Scores of predicted labels, by case.

    Args:
        cases: Each case's scores: of its foreground, or their means over its classes.
        classes: Each case's scores by class, of the classes that are in one of its two labels; None where labels are
            scored as one foreground.
        predicted_alone: Cases and classes that are in the prediction and not in the truth.
        missed: Those that are in the truth and not in the prediction.
    """

    cases: Mapping[str, Scores]
    classes: Mapping[str, Mapping[int, Scores]] | None
    predicted_alone: tuple[tuple[str, int], ...] = ()
    missed: tuple[tuple[str, int], ...] = ()


def score_labels(predictions: Path, truths: Path, device: torch.device) -> LabelScores:
    """Score predicted labels of a file or folder against true ones.

    Class by class if of one case both labels have several: then all cases are. Else all classes count as one
    foreground, so that a mask of 255 and one of 1 are the same.

    Args:
        predictions: A label, or a folder of them.
        truths: Likewise.
        device: Where to compute.

    Raises:
        FormatError: As by `label_pairs`.
        GridError: Likewise.

    Warns:
        SDMWarning: A label has several classes, and all count as foreground.
    """
    whole: dict[str, Scores] = {}
    merged: list[tuple[tuple[int, ...], Path]] = []
    pairs: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {}
    classes: dict[str, dict[int, Scores]] = {}
    for pair in label_pairs(predictions, truths):
        pairs[pair.name] = pair.classes
        if classes or all(len(found) > 1 for found in pair.classes):
            classes[pair.name] = _by_class(pair, device)
        else:
            prediction, truth = ((label != 0).to(device) for label in (pair.prediction, pair.truth))
            whole[pair.name] = scores_of(prediction, truth, pair.spacing)
            merged += zip(pair.classes, pair.files, strict=True)
    if not classes:
        for found, path in merged:
            warn_of_classes(found, path)
        return LabelScores(cases=whole, classes=None)
    # Those before the first with several classes in both.
    if whole:
        classes |= {pair.name: _by_class(pair, device) for pair in label_pairs(predictions, truths, whole)}
    classes = {name: classes[name] for name in pairs}
    return LabelScores(
        cases={name: mean_of(list(scores.values())) for name, scores in classes.items()},
        classes=classes,
        predicted_alone=tuple((name, v) for name, (ours, theirs) in pairs.items() for v in ours if v not in theirs),
        missed=tuple((name, v) for name, (ours, theirs) in pairs.items() for v in theirs if v not in ours),
    )


def _by_class(pair: LabelPair, device: torch.device) -> dict[int, Scores]:
    prediction, truth = pair.prediction.to(device), pair.truth.to(device)
    scores = {}
    for value in sorted({*pair.classes[0], *pair.classes[1]}):
        box = _around((prediction == value) | (truth == value))
        scores[value] = scores_of(prediction[box] == value, truth[box] == value, pair.spacing)
    return scores


def _around(mask: Tensor) -> tuple[slice, ...]:
    """The part of the volume with all that is near the foreground, so that scores are those of the whole volume."""
    return tuple(slice(max(0, part.start - AROUND), part.stop + AROUND) for part in foreground_box(mask))
