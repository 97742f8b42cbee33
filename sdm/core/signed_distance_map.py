"""The signed distance map: values on a grid."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from sdm.core.as_grid import GridLike, as_grid
from sdm.core.device import device_to_hold
from sdm.core.given_values import as_level, real, whole
from sdm.core.grid import Grid
from sdm.core.interpolation.tricubic import tricubic
from sdm.core.interpolation.trilinear import trilinear
from sdm.core.mesh import TriangleMesh, as_tensor
from sdm.core.normalization import Normalization
from sdm.core.to_libraries import map_to_nibabel, map_to_pyvista, map_to_sitk
from sdm.errors import GridError, SDMError

# Voxels whose signs are held at a time, a byte each.
COUNTED_AT_ONCE = 1 << 22
# What may be made when it is first asked for, and where the function that makes it is kept.
_LATER = {"values": "_make", "ambiguous_voxels": "_count"}


@dataclass(frozen=True, eq=False, init=False, repr=False)
class SDM:
    """A signed distance map: negative inside, zero on the surface, in the mesh's unit.

    Args:
        values: (nx,ny,nz) float32, a tensor or an array, which is copied; `values[i,j,k]` belongs to
            `grid.origin + grid.spacing * (i,j,k)`.
        grid: Where the values live.
        ambiguous_voxels: How many voxels have a winding number within a quarter of 0.5, so that the mesh does
            not clearly say whether they are inside. 0 for closed meshes; None where nobody counted. Of an open mesh's
            map on a GPU it waits for the device when it is first read, as `inside_voxels` does, the number of negative
            values.
        sign: The method that says what is inside: "winding" (the generalised winding number), "flood" (a flood from
            outside) or "none" (nothing does: all values are distances, of at least 0). None where nobody noted it.
        hole_size: Of "flood", the length of the narrowest gaps that the flood may pass.
        sign_disagreements: How many voxels are inside by one of the methods "winding" and "flood", and outside by the
            other; None where nobody compared them.
        truncated: The length beyond which distances are this length, with their sign; None where none are cut.
        normalization: The shift and the scale that the mesh went through before; None if it stayed as it was.

    `field[i, j, k]`, `numpy.asarray(field)` and `torch.as_tensor(field)` are its values, as is what others make of it
    by DLPack; gradients flow through `values` alone. `torch.save` keeps it, and `torch.load` takes it once
    `sdm.SDM` was used in the process.
    """

    values: Float[Tensor, "nx ny nz"]
    grid: Grid
    ambiguous_voxels: int | None
    sign: str | None = None
    hole_size: float | None = None
    sign_disagreements: int | None = None
    truncated: float | None = None
    normalization: Normalization | None = None

    def __init__(
        self,
        values: Tensor | np.ndarray,
        grid: GridLike,
        ambiguous_voxels: int | None = None,
        *,
        sign: str | None = None,
        hole_size: float | None = None,
        sign_disagreements: int | None = None,
        truncated: float | None = None,
        normalization: Normalization | None = None,
    ) -> None:
        if not isinstance(values, Tensor):
            values = np.asarray(values)
            # What NumPy computed is a map too; float64 is rounded, as the engine's own values are.
            if values.dtype.kind not in "fiu":
                raise SDMError(f"values of a map are real numbers, not {values.dtype}")
            values = torch.from_numpy(np.array(values, np.float32))
        grid = grid if isinstance(grid, Grid) else as_grid(grid)
        if tuple(values.shape) != grid.shape:
            raise GridError(f"values of shape {tuple(values.shape)} do not fit a grid of shape {grid.shape}")
        self.__dict__.update(
            values=values,
            grid=grid,
            ambiguous_voxels=ambiguous_voxels,
            sign=sign,
            hole_size=hole_size,
            sign_disagreements=sign_disagreements,
            truncated=truncated,
            normalization=normalization,
        )

    @classmethod
    def later(
        cls,
        make: Callable[[], Tensor],
        grid: Grid,
        ambiguous_voxels: int | None,
        *,
        sign: str,
        check: Callable[[Grid, int], None] | None = None,
    ) -> SDM:
        """A map on a GPU whose values `make` gives when they are first asked for; with a `check`, see `checked_by`.

        Of hundreds of small maps in one tensor the host would take longer to make views than the device to fill them.
        """
        field = cls.__new__(cls)
        field.__dict__.update(_make=make, grid=grid, ambiguous_voxels=ambiguous_voxels, sign=sign)
        if check is not None:
            field.__dict__["_pending"] = check
        return field

    @classmethod
    def on_gpu(cls, values: Tensor, grid: Grid, *, sign: str, check: Callable[[Grid, int], None] | None = None) -> SDM:
        """A map without ambiguous voxels whose values are known to be on a GPU, and to fit its grid.

        With a `check`, see `checked_by`. Of small maps the host's work is felt.
        """
        field = cls.__new__(cls)
        field.__dict__.update(values=values, grid=grid, ambiguous_voxels=0, sign=sign)
        if check is not None:
            field.__dict__["_pending"] = check
        return field

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            # Only of what is not there: what is to be made.
            kept = _LATER.get(name, "")
            make = self.__dict__.get(kept)
            if make is None:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            found = self.__dict__[name] = make()
            self.__dict__.pop(kept, None)
            return found

    def counted_later(self, count: Callable[[], int]) -> SDM:
        """This map, whose ambiguous voxels `count` tells when they are first asked for, as that waits for a GPU."""
        del self.__dict__["ambiguous_voxels"]
        self.__dict__["_count"] = count
        return self

    def with_values(self, values: Tensor) -> SDM:
        """A map with other values, and all else as it is."""
        return self._with(values=values)

    def _with(self, **other: Any) -> SDM:
        return SDM(**({field.name: getattr(self, field.name) for field in fields(self)} | other))

    @cached_property
    def inside_voxels(self) -> int:
        """Number of voxels with a negative value, counted when it is first read, which waits for the device."""
        self._check()
        return self._count_inside()

    def _count_inside(self) -> int:
        if self.values.device.type != "cpu":
            return int((self.values < 0).sum())
        # By NumPy, as a small map takes torch's threads longer to share than one to count; in large pieces, since each
        # operation hands Python's lock to another thread, and 128 layers would wait for it 256 times.
        values = self.values.detach().numpy()
        layers = max(1, COUNTED_AT_ONCE * len(values) // max(1, values.size))
        return sum(int(np.count_nonzero(values[at : at + layers] < 0)) for at in range(0, len(values), layers))

    def checked_by(self, check: Callable[[Grid, int], None]) -> SDM:
        """This map, with a check that is called once, with its grid and the number of its inside voxels.

        Now if the map is on the host, else when values or counts of it are first read there.
        """
        self.__dict__["_pending"] = check
        if self.values.device.type == "cpu":
            self._check()
        return self

    def _check(self) -> None:
        check = self.__dict__.pop("_pending", None)
        if check is not None:
            check(self.grid, self._count_inside())

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def numpy(self) -> Float32[np.ndarray, "nx ny nz"]:
        """The values on the host, (nx,ny,nz) float32."""
        self._check()
        return self.values.detach().to("cpu", torch.float32).numpy()

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels (nx,ny,nz)."""
        return self.grid.shape

    @property
    def device(self) -> torch.device:
        """The device of the values."""
        return self.values.device

    def to(self, device: torch.device | str) -> SDM:
        """The same map on another device.

        Raises:
            DeviceError: There is none of that name.
        """
        moved = self.with_values(self.values.to(device_to_hold(device)))
        check = self.__dict__.pop("_pending", None)
        return moved if check is None else moved.checked_by(check)

    def cpu(self) -> SDM:
        """The same map on the host."""
        return self.to("cpu")

    def __getitem__(self, index: Any) -> Tensor:
        return self.values[index]

    def __len__(self) -> int:
        return self.shape[0]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        values = self.numpy()
        kept = dtype is None or np.dtype(dtype) == values.dtype
        if copy is False and not (kept and self.values.device.type == "cpu" and self.values.dtype == torch.float32):
            raise ValueError("the values of this map cannot be had as such an array without a copy")
        return values.copy() if copy and kept else values.astype(values.dtype if kept else dtype, copy=False)

    def __dlpack__(self, **options: Any) -> Any:
        self._check()
        return self.values.detach().__dlpack__(**options)

    def __dlpack_device__(self) -> Any:
        return self.values.__dlpack_device__()

    def _repr_html_(self) -> str:
        from sdm.viz.slices import map_html

        return map_html(self)

    def __repr__(self) -> str:
        unclear = f", {self.ambiguous_voxels:,} of them ambiguous" if self.ambiguous_voxels else ""
        sign = (
            "" if self.sign in (None, "winding") else ", unsigned" if self.sign == "none" else f", sign by {self.sign}"
        )
        return f"SDM({self.grid.summary}{unclear}{sign}, on {self.values.device})"

    def sample(self, points: Any, order: int = 1) -> Float[Tensor, "*n"]:
        """Interpolation of the map, which off the voxel centres is near the exact distance, not equal to it.

        Args:
            points: (...,3) coordinates in the mesh's unit, NumPy or torch.
            order: 1 for trilinear, from the eight voxels around; 3 for tricubic
                (`sdm.core.interpolation.tricubic`), from 64: smooth, and nearer where the map is.

        Returns:
            (...) on the map's device, NaN beyond the outermost voxel centres. Differentiable in `points` and in the
            map's values. `sdm.signed_distance` is exact, and needs the mesh.

        Raises:
            GridError: The points are not (...,3).
            SDMError: Another order.
        """
        if whole(order, 1) not in (1, 3):
            raise SDMError(f"maps are interpolated by order 1 (trilinear) or 3 (tricubic), not {order!r}")
        at = as_tensor(points, torch.float64, "the points", device=self.values.device)
        if at.ndim == 0 or at.shape[-1] != 3:
            raise GridError(f"the points have shape {tuple(at.shape)}; (..., 3) is needed")
        interpolated = tricubic if order == 3 else trilinear
        return interpolated(self.values, self.grid, at.reshape(-1, 3)).reshape(at.shape[:-1])

    def gradient(self) -> Float[Tensor, "nx ny nz 3"]:
        """The map's slope at every voxel, (nx,ny,nz,3), along the world's x, y and z: near 1 in length, outward.

        Central differences, one-sided ones at the border, 0 along an axis of one voxel; differentiable in the values.
        """
        slopes = [
            torch.gradient(self.values, spacing=step, dim=axis)[0] if count > 1 else torch.zeros_like(self.values)
            for axis, (step, count) in enumerate(zip(self.grid.spacing, self.shape, strict=True))
        ]
        turn = torch.tensor(self.grid.direction, dtype=self.values.dtype, device=self.values.device)
        return torch.stack(slopes, -1) @ turn.T

    def normalized(self) -> Float[Tensor, "nx ny nz"]:
        """Values from -1 to 1: the inside divided by its depth, the outside by its reach.

        The normalisation of Xue et al. (AAAI 2020) and Ma et al. (MIDL 2020) for networks that regress maps; a side
        without voxels stays as it is. `truncate` first, where all maps shall have one scale near the surface.
        """
        inside, outside = (-self.values).clamp(min=0), self.values.clamp(min=0)
        deep, far = (side.amax().clamp(min=torch.finfo(side.dtype).tiny) for side in (inside, outside))
        return outside / far - inside / deep

    def occupancy(self, level: float = 0.0) -> Bool[Tensor, "nx ny nz"]:
        """True for voxels whose distance is below `level`: inside.

        Raises:
            SDMError: A level that is no number.
        """
        return self.values < as_level(level)

    def truncate(self, distance: float) -> SDM:
        """The map with values beyond `distance` cut to it, on both sides, which `truncated` tells.

        Raises:
            SDMError: A distance that is not positive.
        """
        distance, given = real(distance), distance
        if not 0 < distance < math.inf:
            raise SDMError(f"a map cannot be truncated at {given!r}: give a positive length")
        known = distance if self.truncated is None else min(distance, self.truncated)
        return self._with(values=self.values.clamp(-distance, distance), truncated=known)

    def plot(self, unit: str | None = None) -> Any:
        """A matplotlib figure of the three middle slices: red is inside. Notebooks show it.

        Args:
            unit: The mesh's unit of length for the labels, for example "mm".
        """
        from sdm.viz.slices import slices_figure

        return slices_figure(self, unit)

    def to_trimesh(self, level: float = 0.0) -> Any:
        """The surface at `level` as a `trimesh.Trimesh`; see `to_mesh`."""
        return self.to_mesh(level).to_trimesh()

    def to_open3d(self, level: float = 0.0) -> Any:
        """The surface at `level` as an `open3d.geometry.TriangleMesh`; see `to_mesh`."""
        return self.to_mesh(level).to_open3d()

    def to_pyvista(self) -> Any:
        """A `pyvista.ImageData` whose points are the voxel centres, with the values as `implicit_distance`."""
        return map_to_pyvista(self)

    def to_sitk(self) -> Any:
        """A `SimpleITK.Image` of the map, in LPS coordinates."""
        return map_to_sitk(self)

    def to_nibabel(self) -> Any:
        """A `nibabel.Nifti1Image` of the map, in RAS coordinates."""
        return map_to_nibabel(self)

    def save(self, path: str | Path) -> None:
        """Write to a file whose name's ending is the format, as `sdm.save` does; atomic.

        Raises:
            FormatError: Another ending, or a place that cannot be written.
        """
        from sdm.io import save

        save(self, path)

    def to_mesh(
        self, level: float = 0.0, *, method: Literal["cubes", "dual"] = "cubes", mesh: Any = None
    ) -> TriangleMesh:
        """The surface where the distance is `level`, by marching cubes or dual contouring on the map's device.

        Args:
            level: In the mesh's unit. Voxels of less are inside; those of exactly the level are outside.
            method: `"cubes"`, or `"dual"`, whose vertices lie in cells, on sharp edges and corners where there are any.
            mesh: For `"dual"`, the mesh or the `MeshIndex` that the map is of: crossings and normals are then those of
                its closest points, and edges stay sharp: at level 0 an edge at which two faces meet by more than
                30 degrees is meant to be within 0.05 voxels of the surface, as all were on three meshes (edges that
                faces share by their indices; not those hidden inside). That takes longer the more of them there are,
                on a scan several times as long. Without it they are the map's, which blurs edges by a
                voxel.

        Returns:
            A mesh on the map's device that faces outward: one vertex for each voxel edge that the surface crosses, at
            least a 1,024th of the edge from its ends, so that no triangle has an area of zero; and in some ambiguous
            cells one in the middle. Each edge has two triangles, one each way, but at the grid's border, where the
            surface ends. The order of vertices and triangles is the same on every device. Whether inside corners of a
            voxel face are joined across it is decided by its four values (Nielson and Hamann's asymptotic decider).
            By `"dual"` a vertex for each piece of the surface in a cell, and two triangles around each voxel edge; with
            a mesh also vertices on its edges where several share a cell, so that one vertex would cut some off.

        Raises:
            SDMError: No voxel edge crosses `level`, the grid is one voxel thin, or another method.

        Memory grows with the surface; of the map's size are two numbers for each 8^3 voxels. Waits for a GPU once, by
        `"dual"` twice, and with a mesh as often as it puts points of edges in.
        """
        from sdm.engine.surface import isosurface

        self._check()
        return isosurface(self, level, method, mesh)


# `torch.load` makes no objects but those of classes that it was told of: these hold tensors and numbers alone.
torch.serialization.add_safe_globals([SDM, Grid, TriangleMesh, Normalization])
