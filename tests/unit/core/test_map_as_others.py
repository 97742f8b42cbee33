"""Maps as tensors, arrays, pictures and objects of other libraries."""

from __future__ import annotations

import re
import sys

import nibabel as nib
import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube
from sdm.core.as_grid import as_grid

TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
GRID = sdm.Grid((3.5, -2.0, -3.0), (0.5, 1.0, 0.75), (9, 8, 8), TURN)
MESH = sdm.TriangleMesh(*cube())
BALL = sdm.SDM(GRID.points().norm(dim=-1) - 1.2, GRID)


def same_grid(image: object) -> None:
    np.testing.assert_allclose(as_grid(image).affine, GRID.affine, atol=1e-6)
    assert as_grid(image).shape == GRID.shape


def test_tensors_share_the_values():
    for tensor in (torch.as_tensor(BALL), torch.asarray(BALL), torch.from_dlpack(BALL)):
        assert torch.equal(tensor, BALL.values)
        assert tensor.data_ptr() == BALL.values.data_ptr()
    assert np.from_dlpack(BALL).shape == GRID.shape
    np.testing.assert_array_equal(np.asarray(BALL), BALL.values)
    assert torch.as_tensor(BALL.with_values(BALL.values.clone().requires_grad_())).requires_grad is False


def test_gradient():
    slope = BALL.gradient()
    assert slope.shape == (*GRID.shape, 3)
    away = torch.nn.functional.normalize(GRID.points(), dim=-1)
    off = (slope - away).norm(dim=-1)[1:-1, 1:-1, 1:-1]
    assert float(off[(BALL.values > 1)[1:-1, 1:-1, 1:-1]].max()) < 0.15
    thin = sdm.Grid((0, 0, 0), (1, 1, 1), (1, 3, 3))
    assert sdm.SDM(torch.rand(1, 3, 3), thin).gradient()[..., 0].eq(0).all()


def test_normalized_values_fill_both_sides():
    values = BALL.normalized()
    assert (float(values.min()), float(values.max())) == (-1, 1)
    assert torch.equal(values < 0, BALL.values < 0)
    outside = BALL.with_values(BALL.values.abs() + 1)
    assert float(outside.normalized().max()) == 1
    assert BALL.with_values(torch.zeros(GRID.shape)).normalized().eq(0).all()


def test_occupancy_and_truncation():
    assert int(BALL.occupancy().sum()) == BALL.inside_voxels > 0
    assert int(BALL.occupancy(100).sum()) == GRID.size
    cut = BALL.truncate(0.5)
    assert (float(cut.values.min()), float(cut.values.max())) == (-0.5, 0.5)
    assert cut.truncated == 0.5
    assert cut.truncate(2).truncated == 0.5
    assert BALL.truncated is None
    with pytest.raises(sdm.SDMError, match="truncated at 0: give a positive length"):
        BALL.truncate(0)


def test_plot_and_notebooks():
    figure = BALL.plot("mm")
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert len(figure.axes) == 4
    page = BALL._repr_html_()
    assert "data:image/png;base64" in page
    assert "9 × 8 × 8" in page
    assert len(page) < 70_000
    sdm.SDM(torch.full((1, 1, 4), torch.nan), sdm.Grid((0, 0, 0), (1, 1, 1), (1, 1, 4)))._repr_html_()


def test_reports_in_notebooks():
    page = sdm.inspect_mesh(sdm.TriangleMesh(*cube(), name="<b>.ply"))._repr_html_()
    assert "&lt;b&gt;.ply" in page
    assert "<b>.ply" not in page
    assert re.search(r"closed</th><td[^>]*>yes", page)
    assert "nothing deserves attention" in page
    assert "boundary" in sdm.inspect_mesh(sdm.TriangleMesh(MESH.vertices, MESH.faces[1:]))._repr_html_()


def test_trimesh():
    assert BALL.to_trimesh().is_watertight
    np.testing.assert_array_equal(MESH.to_trimesh().faces, MESH.faces)


def test_nibabel(tmp_path):
    image = BALL.to_nibabel()
    same_grid(image)
    nib.save(image, tmp_path / "ball.nii")
    np.testing.assert_array_equal(sdm.load(tmp_path / "ball.nii").values, BALL.values)


def test_simpleitk():
    sitk = pytest.importorskip("SimpleITK")
    image = BALL.to_sitk()
    same_grid(image)
    np.testing.assert_array_equal(sitk.GetArrayFromImage(image).transpose(), BALL.values)
    # A place by ITK's own arithmetic, which counts in LPS.
    x, y, z = image.TransformIndexToPhysicalPoint((3, 2, 1))
    np.testing.assert_allclose((-x, -y, z), GRID.points()[3, 2, 1], atol=1e-6)


def test_pyvista():
    pyvista = pytest.importorskip("pyvista")
    image = BALL.to_pyvista()
    same_grid(image)
    np.testing.assert_allclose(image.points, GRID.points().permute(2, 1, 0, 3).reshape(-1, 3), atol=1e-5)
    np.testing.assert_array_equal(image["implicit_distance"], BALL.values.permute(2, 1, 0).reshape(-1))
    assert isinstance(MESH.to_pyvista(), pyvista.PolyData)
    assert MESH.to_pyvista().n_cells == 12


def test_open3d():
    pytest.importorskip("open3d", exc_type=ImportError)
    assert MESH.to_open3d().is_watertight()
    assert BALL.to_open3d().is_watertight()


def test_a_library_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    with pytest.raises(sdm.SDMError, match="this needs SimpleITK, which cannot be imported"):
        BALL.to_sitk()
