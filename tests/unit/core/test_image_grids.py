"""Images of other libraries, and their paths, in place of a grid: the same voxel centres, in RAS coordinates."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import nibabel as nib
import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube
from sdm.core.as_grid import as_grid

MESH = sdm.TriangleMesh(*cube())
# Turned by a quarter, so that axes, signs and the order of sizes matter.
TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
GRID = sdm.Grid((-2.0, 3.0, -1.5), (0.5, 1.0, 0.75), (4, 5, 6), TURN)
ZEROS = np.zeros(GRID.shape, np.float32)
LPS = np.diag([-1.0, -1, 1])


class MetaTensor:
    """MONAI's layout: channels first."""

    def __init__(self, affine: np.ndarray, shape: tuple[int, ...], space: str) -> None:
        self.affine, self.shape, self.meta = torch.from_numpy(affine), torch.Size(shape), {"space": space}


def itk(size: tuple[int, ...] = GRID.shape) -> SimpleNamespace:
    """SimpleITK's layout, in LPS coordinates."""
    return SimpleNamespace(
        GetSize=lambda: size,
        GetSpacing=lambda: GRID.spacing[: len(size)],
        GetOrigin=lambda: tuple(LPS @ GRID.origin)[: len(size)],
        GetDirection=lambda: tuple((LPS @ TURN).ravel()),
    )


IMAGES: dict[str, Any] = {
    "grid": GRID,
    "map": sdm.SDM(ZEROS, GRID),
    "nibabel": nib.Nifti1Image(ZEROS, GRID.affine),
    "nibabel in time": nib.Nifti1Image(np.zeros((*GRID.shape, 3), np.float32), GRID.affine),
    "torchio": SimpleNamespace(affine=GRID.affine, spatial_shape=GRID.shape, shape=(1, *GRID.shape)),
    "monai": MetaTensor(GRID.affine, (2, *GRID.shape), "RAS"),
    "monai without channels": MetaTensor(GRID.affine, GRID.shape, "RAS"),
    "monai in LPS": MetaTensor(np.diag([-1.0, -1, 1, 1]) @ GRID.affine, (1, *GRID.shape), "LPS"),
    "simpleitk": itk(),
    "pyvista": SimpleNamespace(
        origin=GRID.origin,
        spacing=GRID.spacing,
        dimensions=GRID.shape,
        direction_matrix=TURN,
        extent=(0, 3, 0, 4, 0, 5),
    ),
    "pyvista, cut out": SimpleNamespace(
        origin=np.asarray(GRID.origin) - TURN @ np.multiply(GRID.spacing, (2, 0, 1)),
        spacing=GRID.spacing,
        dimensions=GRID.shape,
        direction_matrix=TURN,
        extent=(2, 5, 0, 4, 1, 6),
    ),
}


def same(found: sdm.Grid) -> None:
    assert found.shape == GRID.shape
    np.testing.assert_allclose(found.affine, GRID.affine, atol=1e-6)


@pytest.mark.parametrize("kind", IMAGES)
def test_images(kind):
    same(as_grid(IMAGES[kind]))
    same(sdm.io.grid_like(IMAGES[kind]))


def test_every_call_takes_images(tmp_path):
    path = tmp_path / "image.nii.gz"
    nib.save(IMAGES["nibabel"], path)
    for grid in (IMAGES["nibabel"], path, str(path)):
        same(sdm.signed_distance_map(MESH, grid, device="cpu").grid)
        same(sdm.MeshIndex(MESH, "cpu").signed_distance_map(grid).grid)
        assert next(sdm.MeshIndex(MESH, "cpu").slabs(grid))[2].shape == GRID.shape
        assert sdm.signed_distance_maps(MESH.vertices[None], MESH.faces, grid, device="cpu").shape[1:] == GRID.shape
        fields = sdm.signed_distance_maps([MESH, MESH], [grid, 5], device="cpu")
        assert [field.shape for field in fields] == [GRID.shape, (5, 5, 5)]
        assert sdm.SDMStream(sdm.shapes.make_family("ellipsoid"), grid, device="cpu").grid.shape == GRID.shape
    family = sdm.shapes.make_family("ellipsoid")
    assert sdm.SDMStream(family, 8, device="cpu").grid == family.grid(8)


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        (object(), "object is no grid: give a Grid, a number of voxels .* SimpleITK"),
        (torch.zeros(3, 3, 3), "Tensor is no grid"),
        (itk((4, 5)), "an image of 2 dimensions is no grid"),
        (nib.Nifti1Image(np.zeros((4, 5), np.float32), np.eye(4)), r"shape \(4, 5\) is no grid: three axes"),
        (nib.Nifti1Image(ZEROS, np.eye(4) + np.eye(4, k=1)), "not a rotation"),
        (64, "64, says nothing without a mesh"),
    ],
)
def test_what_is_no_image(grid, message):
    with pytest.raises(sdm.GridError, match=message):
        as_grid(grid)


def test_a_path_that_is_not_there():
    with pytest.raises(sdm.FormatError, match="there is no file none"):
        sdm.signed_distance_map(MESH, "none.nii")


def test_simpleitk():
    image = pytest.importorskip("SimpleITK").GetImageFromArray(ZEROS.transpose())
    image.SetSpacing(GRID.spacing)
    image.SetOrigin((LPS @ GRID.origin).tolist())
    image.SetDirection((LPS @ TURN).ravel().tolist())
    same(as_grid(image))


def test_pyvista():
    image = pytest.importorskip("pyvista").ImageData(dimensions=GRID.shape, spacing=GRID.spacing, origin=GRID.origin)
    image.direction_matrix = TURN
    same(as_grid(image))


def test_monai():
    same(as_grid(pytest.importorskip("monai.data").MetaTensor(torch.zeros(1, *GRID.shape), affine=GRID.affine)))


def test_torchio():
    same(as_grid(pytest.importorskip("torchio").ScalarImage(tensor=torch.zeros(1, *GRID.shape), affine=GRID.affine)))
