"""MetaImage files: turned from ITK's coordinates, as ITK itself reads and writes them."""

from __future__ import annotations

import zlib

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


@pytest.mark.parametrize("ending", ["mha", "mhd"])
def test_as_itk(ending, tmp_path):
    sitk = pytest.importorskip("SimpleITK", reason="needs SimpleITK")
    grid = sdm.Grid((1, 2, 3), (0.5, 1, 2), (4, 5, 6), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    field = sdm.SDM(np.random.default_rng(0).normal(size=grid.shape).astype(np.float32), grid)
    path = tmp_path / f"map.{ending}"
    field.save(path)
    theirs, wanted = sitk.ReadImage(str(path)), field.to_sitk()
    np.testing.assert_array_equal(sitk.GetArrayFromImage(theirs), sitk.GetArrayFromImage(wanted))
    for name in ("GetOrigin", "GetSpacing", "GetDirection"):
        np.testing.assert_allclose(getattr(theirs, name)(), getattr(wanted, name)(), atol=1e-12)
    for packed in (False, True):
        sitk.WriteImage(wanted, str(tmp_path / f"scan.{ending}"), packed)
        found = sdm.load(tmp_path / f"scan.{ending}")
        np.testing.assert_array_equal(found.numpy(), field.numpy())
        np.testing.assert_allclose(found.grid.affine, grid.affine, atol=1e-12)


def test_values_of_any_type(tmp_path):
    header = HEADER.replace("LOCAL", "a.raw").replace("MET_UCHAR", "MET_SHORT").replace("4 5 6", "1 2 3")
    (tmp_path / "a.mhd").write_text(header.replace("Compressed", "BinaryDataByteOrderMSB = True\nCompressed"))
    (tmp_path / "a.raw").write_bytes(np.arange(6, dtype=">i2").tobytes())
    assert sdm.load(tmp_path / "a.mhd").numpy().ravel(order="F").tolist() == [0, 1, 2, 3, 4, 5]
    for name, text, message in (
        ("b", header.replace("a.raw", "../a.raw"), "only files beside it"),
        ("c", header.replace("a.raw", "LIST"), "several files"),
        ("d", header.replace("1 2 3", "1 2 4"), "cut off: it has 12 bytes of values, not 16"),
        ("e", header.replace("MET_SHORT", "MET_SHORT_ARRAY"), "plain numbers are needed"),
        ("f", header.replace("ElementType", "ElementNumberOfChannels = 3\nElementType"), "several values a voxel"),
    ):
        (tmp_path / f"{name}.mhd").write_text(text)
        with pytest.raises(sdm.SDMError, match=message):
            sdm.load(tmp_path / f"{name}.mhd")


def test_damage(tmp_path):
    for name, text, message in (
        ("a.mha", "hello", "damaged, or not what its name says"),
        ("b.mha", HEADER.replace("4 5 6", "4 5"), "an image of three dimensions"),
        ("c.mha", HEADER.replace("0.5 1 2", "0 1 2"), "singular"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(sdm.SDMError, match=message):
            sdm.io.grid_like(tmp_path / name)


def test_compressed_values_are_held_against_their_checksum(tmp_path):
    """A file of another program, which has no record of ours: the stream ends where the header says."""
    values = np.random.default_rng(0).integers(0, 60, 120).astype(np.uint8)
    head, packed = (
        HEADER.replace("CompressedData = False", "CompressedData = True").encode(),
        zlib.compress(bytes(values)),
    )
    path = tmp_path / "scan.mha"
    path.write_bytes(head + packed)
    assert np.array_equal(sdm.load(path).numpy().ravel(order="F"), values)
    for place in range(len(packed)):
        for bit in range(8):
            data = bytearray(packed)
            data[place] ^= 1 << bit
            path.write_bytes(head + data)
            try:
                found = sdm.load(path).numpy().ravel(order="F")
            except sdm.SDMError:
                continue
            assert np.array_equal(found, values)
    path.write_bytes(head + zlib.compress(bytes(values) + b"\0"))
    with pytest.raises(sdm.FormatError, match="unpack to more than the voxels that its header declares"):
        sdm.load(path)
    path.write_bytes(head + packed[:-2])
    with pytest.raises(sdm.FormatError, match="cut off"):
        sdm.load(path)
