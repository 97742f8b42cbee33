"""Surfaces in VTK's files: our own come back, VTK's in each of its encodings are read, damage is one sentence."""

from __future__ import annotations

import numpy as np
import pytest

import sdm
from sdm.core.demo_mesh import demo_mesh
from sdm.errors import MeshError

MESH = demo_mesh(rings=9, segments=6, cap_rings=1)
SQUARE = "# vtk DataFile Version 3.0\nby hand\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n0 0 0 1 0 0 1 1 0 0 1 0\n"
GRID = SQUARE.replace("POLYDATA", "UNSTRUCTURED_GRID")


def same(found: sdm.TriangleMesh, atol: float = 0.0) -> None:
    np.testing.assert_allclose(found.vertices, MESH.vertices, atol=atol, rtol=0)
    np.testing.assert_array_equal(found.faces, MESH.faces)


@pytest.mark.parametrize("ending", ["vtk", "vtp"])
def test_as_vtk(ending, tmp_path):
    pyvista = pytest.importorskip("pyvista", reason="needs PyVista, an extra")
    MESH.save(tmp_path / f"ours.{ending}")
    same(sdm.load_mesh(tmp_path / f"ours.{ending}"))
    theirs = pyvista.read(tmp_path / f"ours.{ending}")
    np.testing.assert_array_equal(theirs.points, MESH.vertices)
    np.testing.assert_array_equal(theirs.regular_faces, MESH.faces)
    for binary in (False, True):
        theirs.save(tmp_path / f"theirs.{ending}", binary=binary)
        same(sdm.load_mesh(tmp_path / f"theirs.{ending}"), atol=1e-5)


@pytest.mark.parametrize("mode", [0, 1, 2], ids=["ascii", "binary", "appended"])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("as_text", [False, True])
def test_each_encoding(mode, compressed, as_text, tmp_path):
    vtk = pytest.importorskip("vtk", reason="needs VTK")
    writer = vtk.vtkXMLPolyDataWriter()
    writer.SetInputData(MESH.to_pyvista())
    writer.SetDataMode(mode)
    writer.SetCompressorType(int(compressed))
    writer.SetEncodeAppendedData(as_text)
    # Several blocks.
    writer.SetBlockSize(256)
    writer.SetFileName(str(tmp_path / "a.vtp"))
    writer.Write()
    same(sdm.load_mesh(tmp_path / "a.vtp"), atol=1e-5)


@pytest.mark.parametrize("version", [42, 51])
def test_each_version(version, tmp_path):
    vtk = pytest.importorskip("vtk", reason="needs VTK")
    writer = vtk.vtkPolyDataWriter()
    writer.SetInputData(MESH.to_pyvista())
    writer.SetFileVersion(version)
    writer.SetFileTypeToBinary()
    writer.SetFileName(str(tmp_path / "a.vtk"))
    writer.Write()
    same(sdm.load_mesh(tmp_path / "a.vtk"))


@pytest.mark.parametrize(
    ("cells", "triangles"),
    [
        ("POLYGONS 1 5\n4 0 1 2 3\n", 2),
        ("VERTICES 1 2\n1 0\nLINES 1 3\n2 0 1\nPOLYGONS 2 9\n3 0 1 2\n4 0 1 2 3\nPOINT_DATA 4\nSCALARS a float", 3),
        ("METADATA\nINFORMATION 0\n\nPOLYGONS 2 4\nOFFSETS vtktypeint64\n0 4\nCONNECTIVITY vtktypeint64\n0 1 2 3", 2),
    ],
)
def test_by_hand(cells, triangles, tmp_path):
    text = SQUARE + cells
    (tmp_path / "a.vtk").write_text(text.replace("Version 3.0", "Version 5.1") if "OFFSETS" in cells else text)
    assert sdm.load_mesh(tmp_path / "a.vtk").faces.shape == (triangles, 3)


def test_unstructured_grids(tmp_path):
    (tmp_path / "a.vtk").write_text(GRID + "CELLS 3 11\n3 0 1 2\n2 0 1\n3 0 2 3\nCELL_TYPES 3\n5\n3\n5\n")
    np.testing.assert_array_equal(sdm.load_mesh(tmp_path / "a.vtk").faces, [[0, 1, 2], [0, 2, 3]])
    (tmp_path / "b.vtk").write_text(GRID + "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\n")
    with pytest.raises(MeshError, match="has volume cells or strips"):
        sdm.load_mesh(tmp_path / "b.vtk")


@pytest.mark.parametrize(
    ("ending", "text", "message"),
    [
        ("vtk", "hello", "damaged, or not what its name says"),
        ("vtk", SQUARE.replace("POLYDATA", "STRUCTURED_POINTS"), "has a STRUCTURED_POINTS, not a surface"),
        ("vtk", SQUARE + "TRIANGLE_STRIPS 1 5\n4 0 1 2 3\n", "triangle strips"),
        ("vtk", SQUARE + "POLYGONS 1 5\n4 0 1 2\n", "cut off"),
        ("vtk", SQUARE + "POLYGONS 1 4\n4 0 1 2\n", "do not use up their corners"),
        ("vtk", SQUARE + "POLYGONS 9999999999999 5\n4 0 1 2 3\n", "do not use up their corners"),
        ("vtk", SQUARE + "POLYGONS -1 5\n4 0 1 2 3\n", "do not use up their corners"),
        ("vtk", SQUARE + "POLYGONS 1 4\n3 0 1 9\n", "vertex 9|9"),
        ("vtk", SQUARE, "no triangles"),
        ("vtp", "hello", "it is no XML"),
        ("vtp", '<VTKFile type="ImageData"></VTKFile>', "no VTK file of type PolyData"),
        ("vtp", '<VTKFile type="PolyData" compressor="vtkLZ4DataCompressor"></VTKFile>', "compressed by"),
        ("vtp", '<VTKFile type="PolyData"><PolyData><Piece NumberOfStrips="1"/></PolyData></VTKFile>', "strips"),
    ],
)
def test_damage(ending, text, message, tmp_path):
    (tmp_path / f"a.{ending}").write_text(text)
    with pytest.raises(MeshError, match=message):
        sdm.load_mesh(tmp_path / f"a.{ending}")


@pytest.mark.parametrize("ending", ["vtk", "vtp"])
def test_cut_off(ending, tmp_path):
    path = tmp_path / f"a.{ending}"
    MESH.save(path)
    whole = path.read_bytes()
    for share in (0.3, 0.6, 0.9):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(MeshError, match=r"a\.vt"):
            sdm.load_mesh(path)
