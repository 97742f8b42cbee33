from __future__ import annotations

import numpy as np
import pytest
import torch

from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.errors import GridError, SDMError


@pytest.mark.parametrize("shape", [(3, 3), (2, 3, 4, 4, 4), (1, 1, 1, 2, 2, 2)])
def test_shapes_that_are_no_volumes(shape):
    with pytest.raises(GridError, match="give"):
        euclidean_distance_transform(torch.zeros(shape))


@pytest.mark.parametrize(
    "spacing", [0, -1.0, (1, 1), (1, 1, 0), (1, 1, float("nan")), (1, 1, float("inf")), (1, 1, 1e10)]
)
def test_spacings_that_are_none(spacing):
    with pytest.raises(GridError, match="spacing"):
        euclidean_distance_transform(torch.zeros(3, 3, 3), spacing)


@pytest.mark.parametrize("spacing", [np.float32(0.5), np.int64(2), np.array(0.5), torch.tensor(0.5)])
def test_one_number_of_any_kind_is_a_spacing(spacing):
    mask = torch.zeros(3, 4, 5)
    mask[1, 1, 1] = 1
    found = euclidean_distance_transform(mask, spacing)
    assert torch.equal(found, euclidean_distance_transform(mask, float(spacing)))


def test_a_line_that_is_too_long():
    with pytest.raises(GridError, match="32767"):
        euclidean_distance_transform(torch.zeros(1, 1, 40_000))


def test_the_longest_line():
    mask = torch.zeros(32_767, 1, 1)
    mask[0] = 1
    assert torch.equal(euclidean_distance_transform(mask).flatten(), torch.arange(32_767.0))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_voxels_that_are_no_numbers(dtype):
    mask = torch.zeros(3, 4, 5, dtype=dtype)
    mask[0, 1, 2], mask[2, 1, 2] = 1, float("nan")
    for given in (mask, mask.transpose(0, 2), mask[None, None], mask.double().numpy()):
        for options in ({}, {"signed": True}, {"classes": [1]}, {"classes": "all"}, {"return_nearest": True}):
            with pytest.raises(SDMError, match="are NaN"):
                euclidean_distance_transform(given, **options)
    mask[2, 1, 2] = float("inf")
    assert euclidean_distance_transform(mask)[2, 1, 2] == 0
    with pytest.raises(SDMError, match="whole numbers"):
        euclidean_distance_transform(mask, classes="all")


def test_an_unknown_surface():
    with pytest.raises(SDMError, match="'centres' or 'faces'"):
        euclidean_distance_transform(torch.zeros(3, 3, 3), surface="edges")


def test_an_image_is_refused_with_what_of_it_to_give():
    nibabel = pytest.importorskip("nibabel")
    image = nibabel.Nifti1Image(np.zeros((3, 3, 3), np.uint8), np.eye(4))
    with pytest.raises(SDMError, match=r"image\.dataobj\) and image\.header\.get_zooms"):
        euclidean_distance_transform(image)
