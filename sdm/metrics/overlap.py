"""Overlap of two masks."""

from __future__ import annotations

from sdm.metrics.masks import Mask, masks


def dice(prediction: Mask, truth: Mask) -> float:
    """2 |P and T| / (|P| + |T|): 1 is perfect, 0 no overlap.

    Args:
        prediction: (x,y,z), foreground not zero.
        truth: (x,y,z), foreground not zero.

    Returns:
        0 to 1. NaN where both are empty: there is nothing to overlap.
    """
    prediction, truth = masks(prediction, truth)
    size = int(prediction.sum()) + int(truth.sum())
    return 2 * int((prediction & truth).sum()) / size if size else float("nan")


def jaccard(prediction: Mask, truth: Mask) -> float:
    """|P and T| / |P or T|, the intersection over union: 1 is perfect, 0 no overlap.

    Args:
        prediction: (x,y,z), foreground not zero.
        truth: (x,y,z), foreground not zero.

    Returns:
        0 to 1. NaN where both are empty.
    """
    prediction, truth = masks(prediction, truth)
    union = int((prediction | truth).sum())
    return int((prediction & truth).sum()) / union if union else float("nan")
