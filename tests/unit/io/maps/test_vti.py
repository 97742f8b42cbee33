"""VTK's images: as PyVista writes and reads them."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

import sdm
from sdm.core.as_grid import as_grid
from sdm.errors import FormatError

TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
GRID = sdm.Grid((1, 2, 3), (0.5, 1, 2), (4, 5, 6), TURN)
FIELD = sdm.SDM(np.random.default_rng(0).normal(size=GRID.shape).astype(np.float32), GRID)


def test_as_pyvista(tmp_path):
    pyvista = pytest.importorskip("pyvista", reason="needs PyVista, an extra")
    FIELD.save(tmp_path / "a.vti")
    theirs, wanted = pyvista.read(tmp_path / "a.vti"), FIELD.to_pyvista()
    np.testing.assert_array_equal(theirs["implicit_distance"], wanted["implicit_distance"])
    np.testing.assert_allclose(theirs.points, wanted.points)
    for binary in (False, True):
        wanted.save(tmp_path / "b.vti", binary=binary)
        found = sdm.load(tmp_path / "b.vti")
        np.testing.assert_allclose(found.numpy(), FIELD.numpy(), atol=1e-6)
        np.testing.assert_allclose(found.grid.affine, GRID.affine)
    # Moved by another program, which keeps our record.
    theirs.origin = 9, 9, 9
    theirs.save(tmp_path / "c.vti")
    assert sdm.load(tmp_path / "c.vti").grid.origin == (9, 9, 9)


def test_part_of_an_image(tmp_path):
    """Its extent does not begin at zero."""
    pyvista = pytest.importorskip("pyvista", reason="needs PyVista, an extra")
    image = pyvista.ImageData(dimensions=(3, 4, 5), spacing=(1, 2, 3))
    image["a"] = np.arange(60.0)
    part = image.extract_subset((1, 2, 1, 3, 2, 4))
    part.save(tmp_path / "a.vti")
    found = sdm.load(tmp_path / "a.vti")
    np.testing.assert_allclose(found.grid.affine, as_grid(part).affine)
    np.testing.assert_array_equal(found.numpy().ravel(order="F"), part["a"])


def image(inside: str) -> str:
    return (
        '<VTKFile type="ImageData"><ImageData WholeExtent="0 1 0 0 0 0"><Piece Extent="0 1 0 0 0 0">'
        f"{inside}</Piece></ImageData></VTKFile>"
    )


def array(name: str, kind: str = "Float32") -> str:
    return f'<DataArray type="{kind}" Name="{name}" format="ascii">1 2</DataArray>'


def test_arrays(tmp_path):
    path = tmp_path / "a.vti"
    path.write_text(image(f'<PointData Scalars="b">{array("a")}{array("b", "Int16")}</PointData>'))
    assert sdm.load(path).numpy().ravel().tolist() == [1, 2]
    for inside, message in (
        (f"<PointData>{array('a')}{array('b')}</PointData>", "several arrays, a, b"),
        (f"<CellData>{array('a')}</CellData>", "no values at its points"),
        (f"<PointData>{array('a', 'Bit')}</PointData>", "array of type Bit"),
        (f"<PointData>{array('a').replace('1 2', '1 2 3')}</PointData>", "values of shape"),
    ):
        path.write_text(image(inside))
        with pytest.raises(FormatError, match=message):
            sdm.load(path)


def compressed(values: np.ndarray, block: int) -> tuple[bytes, bytes]:
    """A file as VTK compresses it, in blocks of so many bytes: what is before the packed blocks, and those."""
    plain = values.astype("<f4").tobytes(order="F")
    blocks = [zlib.compress(plain[at : at + block]) for at in range(0, len(plain), block)]
    counters = [len(blocks), block, len(plain) % block, *map(len, blocks)]
    x, y, z = values.shape
    extent = f"0 {x - 1} 0 {y - 1} 0 {z - 1}"
    head = (
        '<VTKFile type="ImageData" header_type="UInt32" compressor="vtkZLibDataCompressor">'
        f'<ImageData WholeExtent="{extent}"><Piece Extent="{extent}"><PointData Scalars="a">'
        '<DataArray type="Float32" Name="a" format="appended" offset="0"/></PointData></Piece></ImageData>'
        '<AppendedData encoding="raw">_'
    )
    return head.encode() + np.array(counters, "<u4").tobytes(), b"".join(blocks)


def test_compressed_values_are_held_against_their_checksum(tmp_path):
    values = np.random.default_rng(0).integers(0, 9, (4, 5, 6)).astype(np.float32)
    head, packed = compressed(values, 200)
    path = tmp_path / "a.vti"
    path.write_bytes(head + packed + b"</AppendedData></VTKFile>")
    np.testing.assert_array_equal(sdm.load(path).numpy(), values)
    for place in range(len(packed)):
        data = bytearray(packed)
        data[place] ^= 1 << place % 8
        path.write_bytes(head + data + b"</AppendedData></VTKFile>")
        try:
            found = sdm.load(path)
        except sdm.SDMError:
            continue
        np.testing.assert_array_equal(found.numpy(), values)
