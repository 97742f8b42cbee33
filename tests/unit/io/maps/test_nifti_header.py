"""Headers of NIfTI maps have the bytes of nibabel's, however the grid lies."""

from __future__ import annotations

from typing import Any

import nibabel as nib
import numpy as np
import pytest
from nibabel.nifti1 import Nifti1Extension

from sdm.core.grid import Grid
from sdm.io.maps.nifti_header import nifti_header


def by_nibabel(values: np.ndarray, affine: np.ndarray, comment: bytes, space: int) -> Any:
    """The image of a map as nibabel makes it."""
    kind = nib.Nifti2Image if max(values.shape) > 32767 else nib.Nifti1Image
    image: Any = kind(values, affine)
    image.header.set_xyzt_units("mm", "unknown")
    image.header["descrip"] = b"signed distance, negative inside"
    image.header.set_intent("estimate", name="distance")
    image.set_sform(affine, space)
    image.set_qform(affine, space)
    image.header.extensions.append(Nifti1Extension(6, comment))
    return image


def directions() -> list[np.ndarray]:
    drawn = np.random.default_rng(3)
    turned = [np.linalg.qr(drawn.normal(size=(3, 3)))[0] for _ in range(20)]
    swapped = np.eye(3)[[1, 2, 0]]
    return [np.eye(3), np.diag([-1.0, -1.0, 1.0]), np.diag([1.0, 1.0, -1.0]), swapped, -swapped, *turned]


@pytest.mark.parametrize("shape", [(2, 3, 4), (40000, 1, 1)], ids=str)
@pytest.mark.parametrize("space", [0, 1])
def test_the_bytes_of_nibabel(shape, space):
    drawn = np.random.default_rng(0)
    values = np.zeros(shape, np.float32)
    for number, direction in enumerate(directions() * 4):
        origin, spacing = 10.0 ** drawn.uniform(-6, 3) * drawn.normal(size=3), 10.0 ** drawn.uniform(-9, 5, 3)
        affine = Grid(tuple(origin), tuple(spacing), shape, direction).affine
        comment = b"x" * (7 * number)
        head = nifti_header(affine, shape, comment, space)
        image = by_nibabel(values, affine, comment, space).to_bytes()
        assert image == head.ljust(len(image) - values.nbytes, b"\0") + values.tobytes()
        assert len(head) == len(image) - values.nbytes
