"""Smooth surfaces from labels."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sdm import inspect_mesh
from sdm.deepsdf import label_surface
from sdm.errors import GridError, SDMError


def ball_label(spacing: tuple[float, float, float], radius: float) -> torch.Tensor:
    """A ball in the middle of a volume that is just large enough for it."""
    count = [int(2 * radius / s) + 1 for s in spacing]
    axes = [(torch.arange(n) - (n - 1) / 2) * s for n, s in zip(count, spacing, strict=True)]
    return torch.stack(torch.meshgrid(*axes, indexing="ij")).norm(dim=0) <= radius


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.6, 0.8, 1.5)])
def test_a_ball_becomes_round_keeps_its_volume_and_its_place(spacing: tuple[float, float, float]) -> None:
    mask = ball_label(spacing, 10.0)
    mesh = label_surface(mask, spacing, smoothing_mm=1.5)
    report = inspect_mesh(mesh)
    assert report.closed
    assert report.outward
    assert report.components == 1
    assert report.volume is not None
    assert report.volume == pytest.approx(float(mask.sum()) * float(np.prod(spacing)), rel=5e-3)
    middle = np.array([(n - 1) / 2 * s for n, s in zip(mask.shape, spacing, strict=True)])
    radius = np.linalg.norm(mesh.vertices.numpy() - middle, axis=1)
    # The steps of the voxels alone are half a voxel.
    assert radius.std() < 0.1 * max(spacing)


def test_the_volume_is_kept_where_smoothing_alone_would_shrink_it() -> None:
    mask = ball_label((1.0, 1.0, 1.0), 4.0)
    volume = inspect_mesh(label_surface(mask, 1.0, smoothing_mm=2.0)).volume
    assert volume is not None
    assert volume == pytest.approx(float(mask.sum()), rel=0.01)


def test_crumbs_are_left_out() -> None:
    mask = torch.zeros(40, 20, 20, dtype=torch.uint8)
    mask[4:16, 4:16, 4:16] = 1
    mask[30:36, 8:14, 8:14] = 1
    mesh = label_surface(mask, 1.0, smoothing_mm=0.8)
    assert inspect_mesh(mesh).components == 1
    assert float(mesh.vertices[:, 0].max()) < 20


def test_a_label_at_the_border_is_closed_there() -> None:
    assert inspect_mesh(label_surface(torch.ones(8, 8, 8), 1.0)).closed


def test_bad_input_is_said() -> None:
    with pytest.raises(SDMError, match="the label is empty"):
        label_surface(torch.zeros(5, 5, 5), 1.0)
    with pytest.raises(SDMError, match="smoothing of 0 mm is not positive"):
        label_surface(torch.ones(5, 5, 5), 1.0, smoothing_mm=0)
    with pytest.raises(GridError, match="spacing"):
        label_surface(torch.ones(5, 5, 5), -1.0)
