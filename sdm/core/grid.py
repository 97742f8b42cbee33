"""The regular grid of voxel centres that a signed distance map lives on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float32, Float64

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.given_values import real, whole
from sdm.errors import GridError

if TYPE_CHECKING:
    Numbers = Sequence[float] | np.ndarray

# Ten times as far as a mesh's largest coordinate: the squares of much longer distances are infinite in float32.
FARTHEST = 1e31
# Voxels along an axis that float32 coordinates tell apart.
MOST_VOXELS = 2**24
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Grid:
    """A regular grid of voxel centres.

    Args:
        origin: (x,y,z) of the centre of voxel (0,0,0), in the mesh's unit.
        spacing: Voxel size along each axis, positive.
        shape: Number of voxels (nx,ny,nz).
        direction: 3x3 rotation or reflection whose columns are the axes' directions, as in a medical image's
            header; the identity if not given.

    Voxel (i,j,k) has its centre at `origin + direction @ (spacing * (i,j,k))`, rounded to float32.

    Raises:
        GridError: No voxels, more than 2**24 of them along an axis, a spacing that is not positive and finite, a grid
            that reaches beyond 1e31, or a direction that is not orthonormal.
    """

    origin: tuple[float, float, float]
    spacing: tuple[float, float, float]
    shape: tuple[int, int, int]
    direction: tuple[tuple[float, float, float], ...] = IDENTITY

    if TYPE_CHECKING:  # what may be given is wider than what is kept

        def __init__(
            self,
            origin: Numbers,
            spacing: Numbers,
            shape: Numbers,
            direction: Sequence[Numbers] | np.ndarray = IDENTITY,
        ) -> None: ...

    def __post_init__(self) -> None:
        origin = _triple(self.origin, "origin")
        spacing = _triple(self.spacing, "spacing")
        size = _triple(self.shape, "shape")
        if not all(math.isfinite(x) for x in origin):
            raise GridError(f"the grid's origin {origin} is not finite; give three finite coordinates")
        if not all(math.isfinite(s) and s > 0 for s in spacing):
            raise GridError(f"the grid's spacing {spacing} must be three positive lengths")
        if not all(math.isfinite(n) and n == int(n) and n >= 1 for n in size):
            raise GridError(f"the grid's shape {tuple(self.shape)} must be three whole numbers of at least 1")
        if max(size) > MOST_VOXELS:
            raise GridError(
                f"the grid has {max(size):.9g} voxels along an axis; at most {MOST_VOXELS:,} are supported, as many as "
                "float32 coordinates tell apart: choose a larger spacing or a lower resolution"
            )
        reach = max(abs(x) + s * (n - 1) for x, s, n in zip(origin, spacing, size, strict=True))
        if reach > FARTHEST:
            raise GridError(
                f"the grid reaches too far: its origin and its length add up to {reach:.3g}; at most {FARTHEST:g} is "
                "supported: use a larger unit, or a smaller margin or spacing"
            )
        direction: Any = IDENTITY
        # NumPy takes longer to look at one than all else here.
        if self.direction is not IDENTITY:
            direction = tuple(tuple(float(x) for x in row) for row in _orthonormal(self.direction))
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "spacing", spacing)
        object.__setattr__(self, "shape", tuple(int(n) for n in size))
        object.__setattr__(self, "direction", direction)

    @classmethod
    def around(
        cls,
        mesh: MeshLike,
        resolution: int | Sequence[int] | None = None,
        *,
        spacing: float | Numbers | None = None,
        margin: float = 0.05,
    ) -> Grid:
        """The grid of cubic voxels that holds `mesh` with room around it.

        Args:
            mesh: The mesh to hold, or whatever `as_mesh` takes for one.
            resolution: Voxels along each axis: one number for a cube, or three; 128 if no spacing is given. The grid is
                centred on the mesh, and its voxels are as small as the axis with the least room allows.
            spacing: Voxel size instead (one length, or one for each axis); the shape then follows the mesh's box.
            margin: Room on each side, as a share of the box's longest edge.

        Raises:
            GridError: Both or a non-positive resolution or spacing, a negative margin, a spacing larger than the
                mesh, or a mesh of size zero with no spacing to tell the voxel size.
        """
        _check_wanted(resolution, spacing, margin)
        mesh = as_mesh(mesh)
        low, high = mesh.bounds
        return cls.around_box(low, high, resolution, spacing=spacing, margin=margin, name=mesh.name)

    @classmethod
    def around_box(
        cls,
        low: np.ndarray,
        high: np.ndarray,
        resolution: int | Sequence[int] | None = None,
        *,
        spacing: float | Numbers | None = None,
        margin: float = 0.05,
        name: str = "the box",
    ) -> Grid:
        """The same around a mesh whose box is known.

        Args:
            low: (3,) float64, lowest coordinates.
            high: (3,) float64, highest ones.
            resolution: As for `around`.
            spacing: The same.
            margin: The same.
            name: Of the mesh, for messages.

        Raises:
            GridError: As `around`.
        """
        _check_wanted(resolution, spacing, margin)
        low, high = np.array(_triple(low, "lowest corner")), np.array(_triple(high, "highest corner"))
        extent = float((high - low).max())
        room = margin * extent
        if spacing is not None:
            step = np.asarray(_triple([spacing] * 3 if np.ndim(spacing) == 0 else spacing, "spacing"))
            if not (np.isfinite(step).all() and (step > 0).all()):
                raise GridError(f"the grid's spacing {spacing} must be positive")
            # A flat mesh may be thinner than a voxel; one of size zero tells nothing of the size of a voxel.
            if (extent > 0 and step.min() > extent + 2 * room) or step.max() > FARTHEST:
                raise GridError(
                    f"a spacing of {spacing} is more than the whole of {name}, {extent:.4g} along its longest "
                    "edge: choose a smaller one"
                )
            count = np.ceil((high - low + 2 * room) / step - 1e-6) + 1
            if count.max() >= 2**31:
                raise GridError(
                    f"a spacing of {spacing} gives {count.max():.3g} voxels along an axis: choose a larger one"
                )
            origin = (low + high) / 2 - step * (count - 1) / 2
            return cls(origin, step, count)
        # In Python's floats: NumPy takes Python's lock for as little twenty times as long.
        count = _resolution(128 if resolution is None else resolution)
        if extent == 0:
            far = f" (in float32, at coordinates of up to {np.abs(high).max():.3g})" if np.abs(high).max() > 1e6 else ""
            raise GridError(f"{name} has size zero{far}, so a resolution says nothing: give a spacing")
        cube = isinstance(resolution, int | None) or np.ndim(resolution) == 0
        box = [extent] * 3 if cube else (high - low).tolist()
        step = max((edge + 2 * room) / max(n - 1, 1) for edge, n in zip(box, count, strict=True))
        ends = zip(low.tolist(), high.tolist(), count, strict=True)
        return cls(tuple((a + b) / 2 - step * (n - 1) / 2 for a, b, n in ends), (step,) * 3, count)

    @property
    def size(self) -> int:
        """Number of voxels."""
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Bytes of one float32 map on this grid."""
        return 4 * self.size

    @property
    def summary(self) -> str:
        """Shape and voxel size in a few words."""
        sizes = self.spacing[:1] if len(set(self.spacing)) == 1 else self.spacing
        return f"{' x '.join(map(str, self.shape))} voxels of {' x '.join(f'{s:.4g}' for s in sizes)}"

    @property
    def affine(self) -> Float64[np.ndarray, "4 4"]:
        """(4,4) float64 matrix from voxel indices to coordinates."""
        matrix = np.eye(4)
        matrix[:3, :3] = np.asarray(self.direction) * np.asarray(self.spacing)
        matrix[:3, 3] = self.origin
        return matrix

    @property
    def is_axis_aligned(self) -> bool:
        """True if the direction is the identity."""
        return self.direction == IDENTITY

    @classmethod
    def from_affine(cls, affine: np.ndarray, shape: Numbers) -> Grid:
        """The grid of an image: `affine` (4,4) maps voxel indices to coordinates.

        Raises:
            GridError: The matrix is singular or sheared.
        """
        matrix = _numbers(affine)
        if matrix is None or matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise GridError("an image's affine must be a finite 4 x 4 matrix")
        spacing = np.linalg.norm(matrix[:3, :3], axis=0)
        if not (spacing > 0).all():
            raise GridError("the image's affine is singular: its voxels have no volume")
        direction = matrix[:3, :3] / spacing
        # Headers keep float32: take the axis directions for exact where they are within its rounding.
        if np.allclose(direction, np.round(direction), atol=1e-6):
            direction = np.round(direction) + 0.0
        return cls(matrix[:3, 3], spacing, shape, direction)

    def points(self, begin: int = 0, end: int | None = None) -> Float32[torch.Tensor, "n ny nz 3"]:
        """Voxel centres (n,ny,nz,3) of the slab `begin <= i < end`, float32 on the host.

        These are exactly the points at which the engine measures.

        Raises:
            GridError: A begin or an end that is no layer of the grid.
        """
        first, last = whole(begin, 0), self.shape[0] if end is None else whole(end, 0)
        if first is None or last is None or max(first, last) > self.shape[0]:
            raise GridError(f"{begin!r} to {end!r} is no slab of a grid of {self.shape[0]} layers along x")
        index = np.meshgrid(np.arange(first, last), *(np.arange(n) for n in self.shape[1:]), indexing="ij")
        # In the order in which `voxel` of `kernels/geometry/voxel_grid.py` rounds.
        rows = np.asarray(self.direction) * np.asarray(self.spacing)
        xyz = [
            self.origin[a] + (rows[a, 0] * index[0] + rows[a, 1] * index[1] + rows[a, 2] * index[2]) for a in range(3)
        ]
        return torch.from_numpy(np.stack(xyz, -1).astype(np.float32))


def _check_wanted(resolution: Any, spacing: Any, margin: Any) -> None:
    if resolution is not None and spacing is not None:
        raise GridError("give a resolution or a spacing for the grid, not both")
    if not 0 <= real(margin) < math.inf:
        raise GridError(f"the grid's margin {margin!r} must be a share of the box of at least 0")


def _resolution(wanted: int | Sequence[int] | np.ndarray) -> tuple[float, float, float]:
    if type(wanted) is int and 0 < wanted <= MOST_VOXELS:
        return (wanted, wanted, wanted)
    numbers = _numbers(wanted)
    fits = numbers is not None and numbers.shape in ((), (3,)) and not isinstance(wanted, str | bytes | bool)
    if numbers is None or not fits or not ((numbers >= 1) & (numbers % 1 == 0)).all():
        if isinstance(wanted, str | bytes):
            said = repr(wanted)
        else:
            said = str(wanted) if numbers is None or numbers.ndim < 2 else f"of shape {numbers.shape}"
        raise GridError(
            f"the grid's resolution {said} must be a whole number of at least 1, or three, one for each axis"
        )
    return _triple(np.broadcast_to(numbers, 3), "resolution")


def _triple(values: object, what: str) -> tuple[float, float, float]:
    if type(values) is tuple and len(values) == 3 and {float, int}.issuperset(map(type, values)):
        return (float(values[0]), float(values[1]), float(values[2]))
    array = _numbers(values)
    if array is None or array.shape != (3,):
        raise GridError(f"the grid's {what} must be three numbers, not {values!r}")
    return (float(array[0]), float(array[1]), float(array[2]))


def _numbers(values: object) -> np.ndarray | None:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None


def _orthonormal(matrix: object) -> np.ndarray:
    """A direction matrix without its header's rounding: distances are measured in its frame, so it must not scale."""
    direction = _numbers(matrix)
    if direction is None or direction.shape != (3, 3) or not np.isfinite(direction).all():
        raise GridError("the grid's direction must be a finite 3 x 3 matrix")
    error = float(np.abs(direction.T @ direction - np.eye(3)).max())
    if error > 1e-4:
        raise GridError("the grid's direction is not a rotation or reflection: sheared grids are not supported")
    if error > 1e-12:
        left, _, right = np.linalg.svd(direction)
        direction = left @ right
    return direction
