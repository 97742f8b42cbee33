"""Grids of MetaImage files: turned from ITK's coordinates, as ITK itself reads them."""

from __future__ import annotations

import numpy as np
import pytest

import sdm

HEADER = """ObjectType = Image
NDims = 3
BinaryData = True
CompressedData = False
TransformMatrix = 0 1 0 -1 0 0 0 0 1
Offset = 2 -3 5
ElementSpacing = 0.5 1 2
DimSize = 4 5 6
ElementType = MET_UCHAR
ElementDataFile = LOCAL
"""
WANTED = [[0, 1, 0, -2], [-0.5, 0, 0, 3], [0, 0, 2, 5], [0, 0, 0, 1]]


@pytest.mark.parametrize("ending", ["mha", "mhd"])
def test_geometry(ending, tmp_path):
    path = tmp_path / f"scan.{ending}"
    path.write_bytes(HEADER.encode() + b"\xff\x00" * 60)
    grid = sdm.io.grid_like(path)
    assert grid.shape == (4, 5, 6)
    np.testing.assert_allclose(grid.affine, WANTED)


def test_as_itk(tmp_path):
    sitk = pytest.importorskip("SimpleITK", reason="needs SimpleITK")
    grid = sdm.Grid((1, 2, 3), (0.5, 1, 2), (4, 5, 6), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    sitk.WriteImage(sdm.SDM(np.zeros(grid.shape), grid).to_sitk(), str(tmp_path / "scan.mha"))
    np.testing.assert_allclose(sdm.io.grid_like(tmp_path / "scan.mha").affine, grid.affine, atol=1e-6)


def test_damage(tmp_path):
    for name, text, message in (
        ("a.mha", "hello", "damaged, or not what its name says"),
        ("b.mha", HEADER.replace("4 5 6", "4 5"), "an image of three dimensions"),
        ("c.mha", HEADER.replace("0.5 1 2", "0 1 2"), "singular"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(sdm.SDMError, match=message):
            sdm.io.grid_like(tmp_path / name)
