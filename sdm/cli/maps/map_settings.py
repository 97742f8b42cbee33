"""Settings of `sdm compute` that are the same for all meshes."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
import torch
from torch import Tensor

from sdm.cli.maps.map_sharing import DEFAULT_RESOLUTION
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.normalization import Normal, Normalization
from sdm.engine.arguments import Orient, Sign
from sdm.errors import FormatError, GridError, MeshError, SDMError
from sdm.io.bands.save_and_load import check_band_target
from sdm.io.maps.formats import check_normalized
from sdm.io.maps.half_precision import require_half_range
from sdm.shapes.family import check_resolution

# Formats that have half precision, by their endings.
WITH_HALF = ("npz", "zarr")


T = TypeVar("T", int, float)


def one_or_three(option: str, values: tuple[T, ...] | None) -> T | tuple[T, ...] | None:
    """The numbers of an option for all axes, or its one number.

    Raises:
        GridError: There are others.
    """
    if values is not None and len(values) not in (1, 3):
        kind = "length" if option == "--spacing" else "number"
        raise GridError(f"{option} takes one {kind} or three, not {len(values)}")
    return values[0] if values is not None and len(values) == 1 else values


@dataclass(frozen=True)
class Settings:
    """Settings that are the same for all meshes.

    Args:
        resolution: Voxels along each axis, one number or three; None for the default.
        spacing: Voxel size in place of it: one length or three.
        like: The grid itself in place of it.
        like_image: The file that it is of, which is not written over.
        margin: Room around the mesh, as a share of its box.
        device: Where to compute.
        orient: Whether faces that disagree, and parts that are inside out, are turned.
        scale: What the vertices are multiplied by.
        mesh_space: `"lps"` negates their x and y.
        normalize: Whether they are then shifted and scaled to a sphere or a cube.
        sign: The method by which maps are signed.
        hole_size: Of a flood, the narrowest gaps that it passes.
        dtype: Of the values in the files.
        truncate: Distances beyond this become this, with their sign.
        band: Half the width of narrow bands, in voxels, which files then have in place of maps.
        resume: Whether maps of the same triangles that are there on the same grid are left.
    """

    resolution: int | tuple[int, ...] | None
    spacing: float | tuple[float, ...] | None
    like: Grid | None
    like_image: Path | None
    margin: float
    device: torch.device
    orient: Orient
    resume: bool
    sign: Sign = "winding"
    hole_size: float | None = None
    scale: float = 1.0
    mesh_space: Literal["ras", "lps"] = "ras"
    normalize: Normal | None = None
    dtype: Literal["float32", "float16"] = "float32"
    truncate: float | None = None
    band: float | None = None

    def __post_init__(self) -> None:
        if self.band is not None:
            from sdm.engine.band.calls import band_method

            band_method(self.band, self.sign, self.hole_size)
            if self.truncate is not None or self.normalize is not None or self.dtype != "float32":
                raise SDMError(
                    "a narrow band is cut at its width, in float32: --truncate, --normalize and --dtype are for maps"
                )
        if self.like is None:
            self._check_grid()
        if not (math.isfinite(self.scale) and self.scale > 0):
            raise MeshError(f"--scale is {self.scale:g}: give a positive number to multiply the vertices by")
        if self.truncate is not None and not (math.isfinite(self.truncate) and self.truncate > 0):
            raise SDMError(f"--truncate is {self.truncate:g}: give a positive length")

    def _check_grid(self) -> None:
        """Refuse what is no grid around any mesh."""
        if self.spacing is None:
            check_resolution(DEFAULT_RESOLUTION if self.resolution is None else self.resolution, self.margin)
            return
        if not all(math.isfinite(s) and s > 0 for s in np.atleast_1d(self.spacing).tolist()):
            raise GridError(f"the grid's spacing {self.spacing} must be positive")
        check_resolution(DEFAULT_RESOLUTION, self.margin)

    def grid(self, mesh: TriangleMesh, box: tuple[np.ndarray, np.ndarray] | None = None) -> Grid:
        """The grid of a mesh's map; `box` is the mesh's where that is known, (3,) lowest and highest coordinates."""
        if self.like is not None:
            return self.like
        return Grid.around_box(
            *(mesh.bounds if box is None else box),
            resolution=self.resolution,
            spacing=self.spacing,
            margin=self.margin,
            name=mesh.name,
        )

    def placed(self, mesh: TriangleMesh) -> tuple[TriangleMesh, Normalization | None]:
        """The mesh in the grid's unit and space, and what it was normalised by."""
        if self.scale != 1 or self.mesh_space != "ras":
            side = -1.0 if self.mesh_space == "lps" else 1.0
            factors = torch.tensor([side, side, 1.0], dtype=torch.float64, device="cpu") * self.scale
            # Half a turn about z: faces look where they looked.
            mesh = TriangleMesh(mesh.vertices.double() * factors, mesh.faces, mesh.name)
        if self.normalize is None:
            return mesh, None
        by = Normalization.of(mesh, self.normalize)
        return by.normalised(mesh), by

    def check_range(self, mesh: TriangleMesh, grid: Grid) -> None:
        """Refuse a map that half precision, if it is wanted, has no numbers for.

        Raises:
            SDMError: See `require_half_range`.
        """
        if self.dtype == "float32":
            return
        # No voxel is further from the mesh than from any of its vertices, and the furthest from one is at a corner.
        vertex = mesh.vertices[int(mesh.faces[0, 0])].double().cpu().numpy()
        ends = np.array(list(itertools.product(*((0, n - 1) for n in grid.shape))))
        corners = ends @ grid.affine[:3, :3].T + grid.affine[:3, 3]
        reach = float(np.linalg.norm(corners - vertex, axis=1).max())
        require_half_range(grid, reach, self.truncate, "--truncate or --normalize")

    def check_format(self, target: Path) -> None:
        """Refuse a format that has no room for what is wanted, whatever the mesh.

        Raises:
            FormatError: Half precision, a narrow band or a normalisation in a format that has none.
        """
        if self.normalize is not None:
            check_normalized(target)
        if self.band is not None:
            check_band_target(target)
        if self.dtype != "float32" and not target.name.lower().endswith(tuple(f".{ending}" for ending in WITH_HALF)):
            raise FormatError(f"{target} cannot hold float16: use .{' or .'.join(WITH_HALF)}, or float32")

    @property
    def voxels(self) -> int | None:
        """Voxels of each map; None where meshes of other sizes have others."""
        if self.like is not None:
            return self.like.size
        resolution = self.resolution if self.resolution is not None else DEFAULT_RESOLUTION
        return None if self.spacing is not None else math.prod(np.broadcast_to(resolution, 3).tolist())

    def stored(self, values: Tensor) -> Tensor:
        """Values as the file has them: cut, and of its type."""
        if self.truncate is not None:
            values = values.clamp(-self.truncate, self.truncate)
        return values.half() if self.dtype == "float16" else values

    @property
    def how(self) -> str:
        """All that a file's values depend on besides the triangles and the grid, for its digest."""
        words = [] if self.sign == "winding" else [self.sign, self.hole_size]
        words += [] if self.dtype == "float32" else [self.dtype]
        words += [] if self.band is None else ["band", self.band]
        words += [] if self.truncate is None else ["truncate", self.truncate]
        return "".join(f" {word}" for word in words)
