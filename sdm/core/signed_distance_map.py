"""The signed distance map: values on a grid."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.errors import GridError, SDMError


@dataclass(frozen=True, eq=False, init=False)
class SDM:
    """A signed distance map: negative inside, zero on the surface, in the mesh's unit.

    Args:
        values: (nx,ny,nz) float32, a tensor or an array, which is copied; `values[i,j,k]` belongs to
            `grid.origin + grid.spacing * (i,j,k)`.
        grid: Where the values live.
        ambiguous_voxels: How many voxels have a winding number within a quarter of 0.5, so that the mesh does
            not clearly say whether they are inside. 0 for closed meshes; None where nobody counted.
    """

    values: Float[Tensor, "nx ny nz"]
    grid: Grid
    ambiguous_voxels: int | None

    def __init__(self, values: Tensor | np.ndarray, grid: Grid, ambiguous_voxels: int | None = None) -> None:
        if isinstance(values, np.ndarray):
            # What NumPy computed is a map too; float64 is rounded, as the engine's own values are.
            if values.dtype.kind not in "fiu":
                raise SDMError(f"values of a map are real numbers, not {values.dtype}")
            values = torch.from_numpy(np.array(values, np.float32))
        if tuple(values.shape) != grid.shape:
            raise GridError(f"values of shape {tuple(values.shape)} do not fit a grid of shape {grid.shape}")
        for name, value in (("values", values), ("grid", grid), ("ambiguous_voxels", ambiguous_voxels)):
            object.__setattr__(self, name, value)

    def numpy(self) -> Float32[np.ndarray, "nx ny nz"]:
        """The values on the host, (nx,ny,nz) float32."""
        return self.values.detach().to("cpu", torch.float32).numpy()

    def save(self, path: str | Path) -> None:
        """Write to `.npz`, `.nii`, `.nii.gz`, `.nrrd`, `.zarr` or `.nvdb`, as the name ends; atomic. See `sdm.io`."""
        from sdm.io import save

        save(self, path)

    def to_mesh(self, level: float = 0.0) -> TriangleMesh:
        """The surface where the distance is `level`, by scikit-image's marching cubes, facing outward.

        Raises:
            SDMError: No voxel edge crosses `level`, or the grid is one voxel thin.
        """
        from skimage.measure import marching_cubes

        values = self.numpy()
        if min(values.shape) < 2:
            raise SDMError(f"a grid of shape {self.grid.shape} is one voxel thin: a surface needs two along each axis")
        if not values.min() < level < values.max():
            raise SDMError(f"the map runs from {values.min():g} to {values.max():g}: no surface at level {level:g}")
        # "descent" puts the low side, the inside of a signed distance map, behind the faces.
        index, faces, _, _ = marching_cubes(values, level, gradient_direction="descent", allow_degenerate=False)
        affine = self.grid.affine
        points = index.astype(np.float64) @ affine[:3, :3].T + affine[:3, 3]
        if np.linalg.det(affine[:3, :3]) < 0:
            faces = faces[:, ::-1]
        return TriangleMesh(points.astype(np.float32), np.ascontiguousarray(faces, dtype=np.int32), "isosurface")
