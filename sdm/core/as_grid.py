"""Conversion of whatever stands for a grid: resolutions, paths of images, and images of other libraries."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from sdm.core.as_mesh import MeshLike
from sdm.core.grid import Grid
from sdm.errors import GridError

# The last stands for images of other libraries, none of which is imported here.
GridLike: TypeAlias = Grid | int | Sequence[int] | str | os.PathLike[str] | Any

WANTED = (
    "give a Grid, a number of voxels along each axis of a grid around the mesh, such as 128, the path of an image, a "
    "map, or an image of nibabel, SimpleITK, ITK, MONAI, TorchIO or PyVista"
)
# Negates x and y: from left-posterior-superior coordinates to right-anterior-superior ones, and back.
LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


def as_grid(
    grid: GridLike | None, mesh: MeshLike | None = None, resolution: int | None = None, margin: float | None = None
) -> Grid:
    """The grid that `grid` stands for.

    Args:
        grid: A `Grid`; voxels along each axis of a cube around the mesh, or three numbers of a box around it; the path
            of an image or a map (`sdm.io.grid_like`); a map; or an image of nibabel, SimpleITK, ITK, MONAI (a
            `MetaTensor`), TorchIO or PyVista (`ImageData`, whose points are the voxel centres). Coordinates of medical
            images are taken as right-anterior-superior, ITK's are turned.
        mesh: The mesh that a resolution needs.
        resolution: Such a number, in place of `grid`.
        margin: Room around the mesh, with a resolution alone; see `Grid.around`.

    Raises:
        GridError: Both a grid and a resolution, neither, nothing that is one, or an image whose axes are not
            orthogonal.
        FormatError: A file that cannot be read.
    """
    if grid is not None and resolution is not None:
        raise GridError("give a grid or a resolution, not both")
    wanted: Any = resolution if grid is None else grid
    if wanted is None:
        raise GridError(f"a map needs a grid: {WANTED}")
    if isinstance(wanted, int | float | np.number | Sequence | np.ndarray) and not isinstance(wanted, str | bytes):
        if mesh is None:
            raise GridError(f"a resolution, {wanted}, says nothing without a mesh: give a Grid or an image")
        # It says what is wrong with a number that is none.
        around: Any = wanted
        return Grid.around(mesh, around, margin=0.05 if margin is None else margin)
    if margin is not None:
        raise GridError("a margin is for grids that a resolution describes: give the grid alone, or Grid.around(mesh)")
    if isinstance(wanted, Grid):
        return wanted
    if isinstance(wanted, str | os.PathLike):
        from sdm.io import grid_like

        return grid_like(os.fspath(wanted))
    return grid_of_image(wanted)


def grid_of_image(image: Any) -> Grid:
    """The grid of an image of another library, or of a map, by what it has.

    Raises:
        GridError: It is none, or has other than three axes.
    """
    for attributes, convert in _KINDS:
        if all(hasattr(image, name) for name in attributes):
            return convert(image)
    raise GridError(f"an object of type {type(image).__name__} is no grid: {WANTED}")


def _of_map(field: Any) -> Grid:
    return as_grid(field.grid)


def _of_torchio(image: Any) -> Grid:
    return _of_affine(image.affine, image.spatial_shape)


def _of_meta_tensor(image: Any) -> Grid:
    # Channels, and batches, come first.
    affine = np.asarray(image.affine, dtype=np.float64)
    if str(dict(image.meta).get("space", "RAS")).upper().endswith("LPS"):
        affine = LPS @ affine
    return _of_affine(affine, tuple(image.shape)[-3:])


def _of_nibabel(image: Any) -> Grid:
    # Time and channels come last.
    return _of_affine(image.affine, tuple(image.shape)[:3])


def _of_itk(image: Any) -> Grid:
    size = image.GetSize() if hasattr(image, "GetSize") else image.GetLargestPossibleRegion().GetSize()
    spacing, origin = np.array(image.GetSpacing(), dtype=np.float64), np.array(image.GetOrigin(), dtype=np.float64)
    if len(spacing) != 3:
        raise GridError(f"an image of {len(spacing)} dimensions is no grid: three are needed")
    affine = np.eye(4)
    affine[:3, :3] = np.array(image.GetDirection(), dtype=np.float64).reshape(3, 3) * spacing
    affine[:3, 3] = origin
    return _of_affine(LPS @ affine, tuple(size))


def _of_pyvista(image: Any) -> Grid:
    direction = np.asarray(getattr(image, "direction_matrix", np.eye(3)), dtype=np.float64)
    # The origin is the place of index zero, with which an extent need not begin.
    first = np.multiply(image.spacing, tuple(getattr(image, "extent", (0,) * 6))[::2])
    return Grid(np.asarray(image.origin) + direction @ first, image.spacing, image.dimensions, direction)


def _of_affine(affine: Any, shape: Sequence[int]) -> Grid:
    if len(shape) != 3:
        raise GridError(f"an image of shape {tuple(shape)} is no grid: three axes are needed")
    return Grid.from_affine(np.asarray(affine, dtype=np.float64), [int(n) for n in shape])


# Attributes that tell a library's images, in the order in which they are looked for.
_KINDS: tuple[tuple[tuple[str, ...], Callable[[Any], Grid]], ...] = (
    (("grid", "values"), _of_map),
    (("affine", "spatial_shape"), _of_torchio),
    (("affine", "meta", "shape"), _of_meta_tensor),
    (("affine", "shape"), _of_nibabel),
    (("GetSpacing", "GetOrigin", "GetDirection"), _of_itk),
    (("dimensions", "spacing", "origin"), _of_pyvista),
)
