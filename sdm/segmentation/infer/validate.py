"""Scores of a network, or of several together, on cases with labels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from torch import Tensor

from sdm.segmentation.data.case import Case
from sdm.segmentation.infer.ensemble import predict_ensemble
from sdm.segmentation.infer.predict import largest_component, predict
from sdm.segmentation.infer.scores import scores_of
from sdm.segmentation.networks.model import SegmentationModel
from sdm.segmentation.train.checkpoint import TrainedModel

Scores = dict[str, float | bool]


def validate(
    model: SegmentationModel,
    cases: Sequence[Case],
    window: Sequence[int],
    *,
    stride: Sequence[int] | None = None,
    mirrors: str = "",
    batch: int = 4,
) -> Iterator[tuple[str, Scores, Scores]]:
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
        yield case.name, *_scores(found.label, case)


def validate_ensemble(
    models: Sequence[TrainedModel],
    cases: Sequence[Case],
    *,
    window: Sequence[int] | None = None,
    stride: Sequence[int] | None = None,
    mirrors: bool = False,
    batch: int = 4,
) -> Iterator[tuple[str, Scores, Scores]]:
    """As `validate`, of the networks' mean: see `predict_ensemble`, also for the arguments."""
    for case in cases:
        found = predict_ensemble(
            models, case.image, window=window, stride=stride, largest=False, mirrors=mirrors, batch=batch
        )
        yield case.name, *_scores(found.label, case)


def _scores(label: Tensor, case: Case) -> tuple[Scores, Scores]:
    if case.label is None:
        raise ValueError(f"{case.name} has no label")
    truth = case.label.to(label.device)
    plain = scores_of(label, truth, case.spacing)
    return plain, scores_of(largest_component(label), truth, case.spacing)
