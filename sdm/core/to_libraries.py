"""Maps and meshes as objects of other libraries, each imported when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from sdm.errors import SDMError

if TYPE_CHECKING:
    from sdm.core.mesh import TriangleMesh
    from sdm.core.signed_distance_map import SDM

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
        raise SDMError(f"this needs {package}, which cannot be imported ({error}): pip install {package}") from error


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
    image.point_data[IMPLICIT_DISTANCE] = field.numpy().ravel(order="F")
    return image


def map_to_sitk(field: SDM) -> Any:
    """A `SimpleITK.Image` in LPS coordinates: x and y of the map's RAS ones are negated."""
    grid = field.grid
    to_lps = np.array([-1.0, -1.0, 1.0])
    image = imported("SimpleITK", "SimpleITK").GetImageFromArray(np.ascontiguousarray(field.numpy().transpose()))
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
