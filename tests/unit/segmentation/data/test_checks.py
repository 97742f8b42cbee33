"""Cases that would spoil a training are named and refused."""

from __future__ import annotations

import pytest
import torch

from sdm.errors import GridError, SDMError
from sdm.segmentation import check_cases
from sdm.segmentation.data.checks import check_image
from tests.helpers.segmentation_cases import AFFINE, SHAPE, case

NAN = torch.full(SHAPE, float("nan"))
BAD = {
    "has an image of shape (26, 24, 20) and a label of shape (3, 3, 3)": {"label": torch.ones(3, 3, 3).bool()},
    "has no foreground": {"label": torch.zeros(SHAPE).bool()},
    "has no background": {"label": torch.ones(SHAPE).bool()},
    "has no label": {"label": None},
    "has values that are not finite": {"image": NAN},
    "has voxels of 1 x 1 x 1 mm where 0.8 x 0.8 x 1.25 mm are expected": {"spacing": (1.0, 1.0, 1.0)},
}


@pytest.mark.parametrize("why", BAD)
def test_bad_cases(why):
    bad = case(1, name="the-bad-one", **BAD[why])
    with pytest.raises(SDMError) as error:
        check_cases([case(0), bad, case(2)])
    assert f"1 of 3 cases cannot be used: the-bad-one {why};" in str(error.value)


def test_good_cases():
    check_cases([case(0), case(1, spacing=(0.81, 0.8, 1.25))])


def test_the_spacing_that_is_asked_for():
    with pytest.raises(SDMError, match="2 of 2 cases"):
        check_cases([case(0), case(1)], spacing=(1.0, 1.0, 1.0))
    with pytest.raises(SDMError, match=r"case0\.nii\.gz has voxels of 0\.8 x 0\.8 x 1\.25 mm"):
        check_image(case(0), (1.0, 1.0, 1.0))


@pytest.mark.parametrize("size", [0.0015, 0.0004, 1234.0])
def test_voxels_of_any_size(size):
    check_cases([case(0, spacing=(size, size, 2 * size)), case(1, spacing=(1.01 * size, size, 2 * size))])


def test_images_that_networks_say_nothing_of():
    check_image(case(0), (0.8, 0.8, 1.25))
    with pytest.raises(SDMError, match=r"case0\.nii\.gz has values that are not finite"):
        check_image(case(0, image=NAN), (0.8, 0.8, 1.25))
    with pytest.raises(SDMError, match=r"case0\.nii\.gz has an image of shape \(1, 26, 24, 20\)"):
        check_image(case(0, image=NAN[None]), (0.8, 0.8, 1.25))
    sheared = AFFINE.copy()
    sheared[0, 1] = 0.4
    with pytest.raises(GridError, match=r"case0\.nii\.gz cannot be segmented: .* sheared"):
        check_image(case(0, affine=sheared), (0.8, 0.8, 1.25))
