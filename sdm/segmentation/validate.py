"""Scores of a network on cases with labels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from sdm.segmentation.case import Case
from sdm.segmentation.model import SegmentationModel
from sdm.segmentation.predict import largest_component, predict
from sdm.segmentation.scores import scores_of


def validate(
    model: SegmentationModel,
    cases: Sequence[Case],
    window: Sequence[int],
    *,
    stride: Sequence[int] | None = None,
    mirrors: str = "",
    batch: int = 4,
) -> Iterator[tuple[str, dict[str, float | bool], dict[str, float | bool]]]:
    """For each case its name, its scores as predicted, and those of the largest connected component alone.

    Args:
        model: A trained network.
        cases: With labels.
        window: Voxels of a window.
        stride: See `sliding_window`.
        mirrors: See `predict`.
        batch: Windows at a time.
    """
    for case in cases:
        found = predict(model, case.image, window, stride=stride, largest=False, mirrors=mirrors, batch=batch)
        if case.label is None:
            raise ValueError(f"{case.name} has no label")
        truth = case.label.to(found.label.device)
        plain = scores_of(found.label, truth, case.spacing)
        yield case.name, plain, scores_of(largest_component(found.label), truth, case.spacing)
