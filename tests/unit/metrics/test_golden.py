"""Metrics against MONAI 1.6.1's on the same masks, with `include_background=True` and `symmetric=True`.

MONAI has no root mean square distance: `test_metrics_surface.py` has that one.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sdm.metrics import SegmentationScores, evaluate_segmentation, hausdorff_distance

SHAPE = (24, 20, 16)


def ellipsoid(centre: tuple[float, ...], radii: tuple[float, ...]) -> np.ndarray:
    return sum(((x - c) / r) ** 2 for x, c, r in zip(np.indices(SHAPE), centre, radii, strict=True)) <= 1


def box(*bounds: tuple[int, int]) -> np.ndarray:
    mask = np.zeros(SHAPE, bool)
    mask[tuple(slice(*b) for b in bounds)] = True
    return mask


ELLIPSOID = ellipsoid((11, 9, 7), (7, 5, 4))
CASES = {
    "ellipsoids": (ELLIPSOID, ellipsoid((12.5, 10, 8), (6, 6, 3.5))),
    "a speck far away": (ELLIPSOID | box((0, 1), (0, 1), (0, 1)), ELLIPSOID),
    "boxes, one at the border": (box((2, 10), (3, 12), (4, 9)), box((4, 13), (3, 10), (0, 9))),
}
# (case, spacing): 95 % Hausdorff, Hausdorff, average symmetric surface distance.
MONAI = {
    ("ellipsoids", (1.0, 1.0, 1.0)): (2.2360680103302, 3.0, 1.009424090385437),
    ("ellipsoids", (0.5, 1.0, 2.5)): (2.692582368850708, 5.0, 1.057728886604309),
    ("a speck far away", (1.0, 1.0, 1.0)): (0.0, 10.392304420471191, 0.019497757777571678),
    ("a speck far away", (0.5, 1.0, 2.5)): (0.0, 12.688577651977539, 0.02380596101284027),
    ("boxes, one at the border", (1.0, 1.0, 1.0)): (4.242640495300293, 5.0, 1.6628352403640747),
    ("boxes, one at the border", (0.5, 1.0, 2.5)): (10.012492179870605, 10.1118745803833, 2.4485652446746826),
}


def scores(case: str, spacing: tuple[float, ...]) -> SegmentationScores:
    return evaluate_segmentation(*map(torch.tensor, CASES[case]), spacing)


@pytest.mark.parametrize(("case", "spacing"), MONAI)
def test_distances(case, spacing):
    hausdorff95, hausdorff, average = MONAI[case, spacing]
    found = scores(case, spacing)
    assert found.hausdorff95_mm == pytest.approx(hausdorff95, rel=1e-6)
    assert found.average_surface_distance_mm == pytest.approx(average, rel=1e-6)
    prediction, truth = map(torch.tensor, CASES[case])
    assert hausdorff_distance(prediction, truth, spacing, 100) == pytest.approx(hausdorff, rel=1e-6)


@pytest.mark.parametrize(
    ("case", "expected"),
    [
        ("ellipsoids", 0.6939146230699365),
        ("a speck far away", 0.9991341991341991),
        ("boxes, one at the border", 0.45307443365695793),
    ],
)
def test_dice_as_in_surface_distance(case, expected):
    """DeepMind's surface-distance 0.1, `compute_dice_coefficient`."""
    found = scores(case, (1.0, 1.0, 1.0))
    assert found.dice == pytest.approx(expected, rel=1e-12)
    assert found.jaccard == pytest.approx(expected / (2 - expected), rel=1e-12)


def test_on_a_gpu_as_on_a_cpu(device):
    for case, spacing in MONAI:
        there = evaluate_segmentation(*(torch.tensor(m, device=device) for m in CASES[case]), spacing)
        assert vars(there) == pytest.approx(vars(scores(case, spacing)), rel=1e-6)
