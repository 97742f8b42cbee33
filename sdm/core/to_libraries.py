"""Maps and meshes as objects of other libraries, each imported when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from sdm.core.axis_order import reversed_axes
from sdm.core.block_lookup import BLOCK
from sdm.errors import SDMError, one_line

if TYPE_CHECKING:
    from sdm.core.mesh import TriangleMesh
    from sdm.core.signed_distance_map import SDM
    from sdm.core.sparse_sdm import SparseSDM

# The array's name in PyVista, by which its own `compute_implicit_distance` goes.
IMPLICIT_DISTANCE = "implicit_distance"


def imported(module: str, package: str) -> Any:
    """A module of a library that need not be installed.

    Raises:
        SDMError: It cannot be imported; says what to install.
    """
    try:
        return import_module(module)
    except ImportError as error:
        why = one_line(error)
        raise SDMError(f"this needs {package}, which cannot be imported ({why}): pip install {package}") from error


def mesh_to_trimesh(mesh: TriangleMesh) -> Any:
    """A `trimesh.Trimesh` with the same vertices and faces, none merged."""
    vertices, faces = mesh.numpy()
    return imported("trimesh", "trimesh").Trimesh(vertices, faces, process=False)


def mesh_to_open3d(mesh: TriangleMesh) -> Any:
    """An `open3d.geometry.TriangleMesh`."""
    open3d = imported("open3d", "open3d")
    vertices, faces = mesh.numpy()
    return open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(vertices.astype(np.float64)), open3d.utility.Vector3iVector(faces)
    )


def mesh_to_pyvista(mesh: TriangleMesh) -> Any:
    """A `pyvista.PolyData`."""
    vertices, faces = mesh.numpy()
    # A count before each face's corners.
    return imported("pyvista", "pyvista").PolyData(vertices, np.insert(faces, 0, 3, axis=1).ravel())


def map_to_pyvista(field: SDM) -> Any:
    """A `pyvista.ImageData` whose points are the voxel centres, with the values as `implicit_distance`."""
    grid = field.grid
    image = imported("pyvista", "pyvista").ImageData(dimensions=grid.shape, spacing=grid.spacing, origin=grid.origin)
    if not grid.is_axis_aligned:
        image.direction_matrix = np.asarray(grid.direction)
    # VTK counts along x first.
    image.point_data[IMPLICIT_DISTANCE] = reversed_axes(field.numpy()).ravel()
    return image


def map_to_sitk(field: SDM) -> Any:
    """A `SimpleITK.Image` in LPS coordinates: x and y of the map's RAS ones are negated."""
    grid = field.grid
    to_lps = np.array([-1.0, -1.0, 1.0])
    image = imported("SimpleITK", "SimpleITK").GetImageFromArray(reversed_axes(field.numpy()))
    image.SetSpacing(grid.spacing)
    image.SetOrigin((to_lps * grid.origin).tolist())
    image.SetDirection((to_lps[:, None] * np.asarray(grid.direction)).ravel().tolist())
    return image


def map_to_nibabel(field: SDM) -> Any:
    """A `nibabel.Nifti1Image`, or `Nifti2Image` beyond 32767 voxels along an axis, in RAS coordinates and mm."""
    nibabel = imported("nibabel", "nibabel")
    kind = nibabel.Nifti1Image if max(field.shape) < 1 << 15 else nibabel.Nifti2Image
    image = kind(field.numpy(), field.grid.affine)
    image.header.set_xyzt_units("mm")
    return image


def band_to_fvdb(band: SparseSDM) -> tuple[Any, Any]:
    """An `fvdb.GridBatch` of one grid, whose voxels are those of a band, and its `fvdb.JaggedTensor` of values.

    Raises:
        SDMError: fvdb cannot be imported; or the grid is turned, which fvdb has no place for.
    """
    fvdb = imported("fvdb", "fvdb-core")
    if not band.grid.is_axis_aligned:
        raise SDMError("fvdb's grids have an origin and a voxel size alone: a band on a turned grid is none of them")
    near = band.values.detach().abs() < band.width
    place, *inner = near.nonzero(as_tuple=True)
    voxels = (BLOCK * band.blocks[place] + torch.stack(inner, -1)).int()
    jagged = fvdb.JaggedTensor([voxels])
    # The method since 0.3, and the function before.
    make = fvdb.GridBatch.from_ijk if hasattr(fvdb.GridBatch, "from_ijk") else fvdb.gridbatch_from_ijk
    grid = make(jagged, voxel_sizes=list(band.grid.spacing), origins=list(band.grid.origin))
    # The grid has an order of its own. `index_put` carries gradients to the band's values.
    index = grid.ijk_to_index(jagged).jdata.long()
    values = band.values.new_zeros(len(voxels)).index_put((index,), band.values[near])
    return grid, fvdb.JaggedTensor([values])
