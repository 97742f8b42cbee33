"""The narrow band of a signed distance map: blocks of voxels near the surface alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float, Int32, Int64
from torch import Tensor

from sdm.core.block_lookup import BLOCK, are_in_runs, blocks_along, find_blocks, keys_of
from sdm.core.device import device_to_hold
from sdm.core.given_values import whole
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh, as_tensor
from sdm.core.signed_distance_map import SDM
from sdm.errors import GridError, SDMError

# A box of voxels: its first, and the one after its last.
Box = tuple[Sequence[int], Sequence[int]]


@dataclass(frozen=True, eq=False, repr=False)
class SparseSDM:
    """A narrow band: the voxels nearer to the surface than a width, in blocks of 8^3; negative inside.

    Args:
        blocks: (N,3) int32, sorted by x, then y, then z: block (a,b,c) has the voxels (8a,8b,8c) to (8a+7,8b+7,8c+7).
            Those are there that have a voxel in the band, which is nearer to the surface than `width`.
        values: (N,8,8,8) float32: in the band the exact signed distance, bit for bit the dense map's; beyond it minus
            the width inside and the width outside. So all values are the dense map's, clamped. Voxels beyond the
            grid's last have the width, as if they were outside.
        inside: (R,4) int32, the blocks that are not stored and lie inside, in runs along z, sorted as blocks are: x and
            y, the first z, and the one after the last. All their voxels are minus the width, and those of all others
            the width.
        grid: Where the voxels are. Nothing here has its size but memory of `to_dense`.
        width: Half the band's width in the mesh's unit, of which all values are at most: the background.
        ambiguous_voxels: Of the voxels in the band, how many have a winding number within a quarter of 0.5.
        sign: As in `SDM`.
        hole_size: Of `sign="flood"`, the width of the gaps that it just passes; None otherwise.

    Of a mesh that is not closed, the sign may change far from the surface, where a winding number passes 0.5. Stored
    blocks have it voxel by voxel, and of others it is a voxel in the middle that says it.

    `torch.save` keeps it, and `torch.load` takes it once `sdm.SparseSDM` was used in the process.
    """

    blocks: Int32[Tensor, "n 3"]
    values: Float[Tensor, "n 8 8 8"]
    inside: Int32[Tensor, "r 4"]
    grid: Grid
    width: float
    ambiguous_voxels: int | None = None
    sign: str | None = None
    hole_size: float | None = None

    def __post_init__(self) -> None:
        wanted = {"blocks": (3,), "values": (BLOCK,) * 3, "inside": (4,)}
        for name, shape in wanted.items():
            if tuple(getattr(self, name).shape[1:]) != shape:
                raise GridError(
                    f"{name} of a band have the shape {tuple(getattr(self, name).shape)}; "
                    f"(N, {', '.join(map(str, shape))}) is needed"
                )
        if len(self.blocks) != len(self.values):
            raise GridError(f"a band has {len(self.blocks)} blocks, and values for {len(self.values)}")
        if not (math.isfinite(self.width) and self.width > 0):
            raise GridError(f"the width {self.width} of a band must be a positive length")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels (nx,ny,nz) of the grid."""
        return self.grid.shape

    @property
    def device(self) -> torch.device:
        """The device of the values."""
        return self.values.device

    @property
    def half_width(self) -> float:
        """The width in voxels: in the longest of their edges."""
        return self.width / max(self.grid.spacing)

    @property
    def nbytes(self) -> int:
        """Bytes of all tensors."""
        return sum(tensor.nbytes for tensor in (self.blocks, self.values, self.inside))

    @cached_property
    def keys(self) -> Int64[Tensor, " n"]:
        """(N,) int64, ascending: numbers of the blocks, see `sdm.core.block_lookup.keys_of`."""
        return keys_of(self.blocks, blocks_along(self.shape))

    @cached_property
    def active_voxels(self) -> int:
        """Number of voxels in the band; counting them waits for the device."""
        return int((self.values.detach().abs() < self.width).sum())

    @cached_property
    def inside_voxels(self) -> int:
        """Number of voxels of the grid with a negative value; counting them waits for the device."""
        x, y, begin, end = self.inside.long().unbind(1)
        nx, ny, nz = self.shape
        across = (nx - BLOCK * x).clamp(max=BLOCK) * (ny - BLOCK * y).clamp(max=BLOCK)
        hidden = across * ((BLOCK * end).clamp(max=nz) - BLOCK * begin)
        return int((self.values.detach() < 0).sum() + hidden.sum())

    def with_values(self, values: Float[Tensor, "n 8 8 8"]) -> SparseSDM:
        """A band with other values, such as ones that are trained, and all else as it is."""
        kept = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "values"}
        return SparseSDM(values=values, **kept)

    def to(self, device: torch.device | str) -> SparseSDM:
        """The same band on another device.

        Raises:
            DeviceError: There is none of that name.
        """
        where = device_to_hold(device)
        tensors = {name: getattr(self, name).to(where) for name in ("blocks", "values", "inside")}
        return SparseSDM(**tensors, **{name: getattr(self, name) for name in _PLAIN})

    def cpu(self) -> SparseSDM:
        """The same band on the host."""
        return self.to("cpu")

    def __len__(self) -> int:
        return len(self.blocks)

    def __repr__(self) -> str:
        count = f"{len(self.blocks):,} blocks of {BLOCK}^3"
        return f"SparseSDM({count} of {self.grid.summary}, half width {self.half_width:.4g}, on {self.device})"

    def find(self, blocks: Any) -> Int64[Tensor, "*m"]:
        """Places (...) of blocks (...,3) among those that are stored; -1 for others, also beyond the grid."""
        wanted = torch.as_tensor(blocks, device=self.device)
        count = blocks_along(self.shape)
        within = ((wanted >= 0) & (wanted < torch.tensor(count, device=self.device))).all(-1)
        return torch.where(within, find_blocks(self.keys, keys_of(wanted, count)), -1)

    def background(self, blocks: Any) -> Float[Tensor, "*m"]:
        """The value (...) of all voxels of blocks (...,3) that are not stored: the width, or minus the width inside."""
        wanted, count = torch.as_tensor(blocks, device=self.device), blocks_along(self.shape)
        within = ((wanted >= 0) & (wanted < torch.tensor(count, device=self.device))).all(-1)
        inside = within & are_in_runs(self.inside, keys_of(wanted, count), count)
        return torch.where(inside, -self.width, self.width).to(self.values.dtype)

    def at(self, voxels: Any) -> Float[Tensor, "*m"]:
        """Values (...) of voxels (...,3) of the grid, by their whole-number indices; differentiable in the values."""
        index = torch.as_tensor(voxels, device=self.device).long()
        blocks, inner = torch.div(index, BLOCK, rounding_mode="floor"), index % BLOCK
        place = find_blocks(self.keys, keys_of(blocks, blocks_along(self.shape)))
        number = (inner[..., 0] * BLOCK + inner[..., 1]) * BLOCK + inner[..., 2]
        if not len(self.blocks):
            return self.background(blocks)
        stored = self.values.reshape(-1)[place.clamp(min=0) * BLOCK**3 + number]
        return torch.where(place >= 0, stored, self.background(blocks))

    def to_dense(self, box: Box | None = None) -> SDM:
        """The whole map, or that of a box of voxels, as an `SDM`; differentiable in the values.

        Args:
            box: The first voxel (i,j,k) and the one after the last, within the grid.

        Raises:
            GridError: The box is empty, or reaches beyond the grid.
        """
        from sdm.core.sparse_dense import dense_values

        begin, end = _whole_box(self.shape) if box is None else _checked_box(box, self.shape)
        values = dense_values(self, begin, end)
        matrix = self.grid.affine
        origin = matrix[:3, 3] + matrix[:3, :3] @ begin
        shape = [high - low for low, high in zip(begin, end, strict=True)]
        grid = self.grid if box is None else Grid(origin, self.grid.spacing, shape, self.grid.direction)
        return SDM(values, grid, sign=self.sign, hole_size=self.hole_size, truncated=self.width)

    def sample(self, points: Any, order: Literal[1, 3] = 1) -> Float[Tensor, "*n"]:
        """Interpolation of the band, as `SDM.sample` interpolates the clamped map.

        Args:
            points: (...,3) coordinates in the mesh's unit, NumPy or torch.
            order: 1 for trilinear, from the eight voxels around; 3 for tricubic
                (`sdm.core.interpolation.tricubic`), from 64.

        Returns:
            (...) on the band's device, NaN beyond the outermost voxel centres. Differentiable in `points` and in the
            values. Where a voxel that it takes is beyond the band, what it gives is clamped too.

        Raises:
            GridError: The points are not (...,3).
            SDMError: Another order.
        """
        from sdm.core.sparse_sampling import interpolate

        at = as_tensor(points, torch.float64, "the points", device=self.device)
        if at.ndim == 0 or at.shape[-1] != 3:
            raise GridError(f"the points have shape {tuple(at.shape)}; (..., 3) is needed")
        if whole(order, 1) not in (1, 3):
            raise SDMError(f"order is {order!r}; use 1 (trilinear) or 3 (cubic)")
        return interpolate(self, at.reshape(-1, 3), order).reshape(at.shape[:-1])

    def gradient(self, points: Any, order: Literal[1, 3] = 1) -> Float[Tensor, "*n 3"]:
        """Derivative (...,3) of `sample` by the points (...,3): outward, of length 1 where the map is a distance.

        Zero where all voxels that are taken are beyond the band, NaN beyond the grid. Differentiable in the values.
        """
        at = as_tensor(points, torch.float64, "the points", device=self.device).detach().requires_grad_()
        with torch.enable_grad():
            found = self.sample(at, order)
            keep = self.values.requires_grad
            (slope,) = torch.autograd.grad(found.nansum(), at, create_graph=keep)
        return slope.to(self.values.dtype).masked_fill(found.isnan()[..., None], torch.nan)

    def save(self, path: str | Path) -> None:
        """Write to `.npz`, `.zarr` or `.nvdb`, as the name ends; atomic. `sdm.load` reads it.

        Raises:
            FormatError: Another ending, or a place that cannot be written.
        """
        from sdm.io import save

        save(self, path)

    def to_mesh(
        self, level: float = 0.0, *, method: Literal["cubes", "dual"] = "cubes", mesh: Any = None
    ) -> TriangleMesh:
        """The surface where the distance is `level`: the very mesh of the dense map's `SDM.to_mesh`, without the map.

        Raises:
            SDMError: The band is too narrow for cells that `level` crosses, as one of less than a cell's diagonal is
                for level 0; or nothing has that level.
        """
        from sdm.engine.surface import band_isosurface

        return band_isosurface(self, level, method, mesh)

    def to_warp(self) -> Any:
        """A `warp.Volume` (NanoVDB) on the band's device: a level set whose active voxels are those of the band.

        Values are copied once, on the device, as NanoVDB's leaves have them between other things. Blocks that are not
        stored are tiles with the width, or minus the width inside.
        """
        from sdm.io.bands.volume import volume_of

        return volume_of(self)

    def to_fvdb(self) -> tuple[Any, Any]:
        """An `fvdb.GridBatch` of one grid on the band's device, and the `fvdb.JaggedTensor` of its values (V,).

        Its voxels are those of the band, nearer to the surface than the width. Values are copied, as fvdb stores them
        in an order of its own; they are differentiable in the band's.

        Raises:
            SDMError: fvdb is not installed, or the grid is turned.
        """
        from sdm.core.to_libraries import band_to_fvdb

        return band_to_fvdb(self)


_PLAIN = ("grid", "width", "ambiguous_voxels", "sign", "hole_size")


def _whole_box(shape: tuple[int, int, int]) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    return (0, 0, 0), shape


def _checked_box(box: Box, shape: tuple[int, int, int]) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    begin, end = ([int(n) for n in corner] for corner in box)
    fits = len(begin) == len(end) == 3
    if not fits or not all(0 <= low < high <= n for low, high, n in zip(begin, end, shape, strict=True)):
        raise GridError(f"the box {tuple(begin)} to {tuple(end)} is no part of a grid of shape {shape}")
    return (begin[0], begin[1], begin[2]), (end[0], end[1], end[2])


torch.serialization.add_safe_globals([SparseSDM])
