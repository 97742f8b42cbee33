"""Narrow bands of meshes: the functions that users call."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Any, TypeAlias, Unpack, overload

import numpy as np
import torch

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.device import choose_device
from sdm.core.given_values import real
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.sparse_sdm import SparseSDM
from sdm.engine.arguments import Orient, Sign, SignMethod, SignOptions
from sdm.engine.band import repeated_bands
from sdm.engine.band.band_slabs import measured_blocks
from sdm.engine.band.flood_bands import flood_band
from sdm.engine.band.inside_runs import inside_runs
from sdm.engine.mesh_index import MeshIndex
from sdm.engine.ragged.mesh_lists import are_meshes
from sdm.errors import GridError
from sdm.runtime.torch_warp import refuse_other_modes

# A grid; the length of its voxels' edges, one or three; or voxels along each axis of one around the mesh.
BandGrid: TypeAlias = Grid | float | Sequence[float]

# With less there are voxels next to the surface that the band does not hold.
LEAST_HALF_WIDTH = 1.5


class BandOptions(SignOptions, total=False):
    """Grid, width, device and signs of a band, as the overloads share them."""

    spacing: float | Sequence[float] | None
    resolution: int | Sequence[int] | None
    half_width: float
    margin: float | None
    device: str | torch.device | None
    orient: Orient


@overload
def narrow_band(
    mesh: list[MeshLike] | tuple[TriangleMesh, ...],
    grid: BandGrid | Sequence[Grid] | None = None,
    **options: Unpack[BandOptions],
) -> list[SparseSDM]: ...
@overload
def narrow_band(
    mesh: MeshLike,
    grid: BandGrid | None = None,
    **options: Unpack[BandOptions],
) -> SparseSDM: ...
def narrow_band(
    mesh: Any,
    grid: Any = None,
    *,
    spacing: float | Sequence[float] | None = None,
    resolution: int | Sequence[int] | None = None,
    half_width: float = 3.0,
    margin: float | None = None,
    device: str | torch.device | None = None,
    orient: Orient = "keep",
    sign: Sign = "winding",
    hole_size: float | None = None,
) -> SparseSDM | list[SparseSDM]:
    """The exact signed distances of the voxels near a mesh's surface, in blocks of 8^3: memory grows with the surface.

    Args:
        mesh: Any triangles, as `sdm.signed_distance_map` takes them; or a list of meshes, which gives a list of bands,
            made one after the other: on a GPU those of a kind that comes again are replayed.
        grid: The voxels; or the length of their edges in the mesh's unit, a `float` or three; or how many there are
            along each axis of a grid around the mesh, a whole number or three. For a list one for all, or a `Grid`
            for each.
        spacing: That length, by name.
        resolution: That number, by name.
        half_width: How far the band reaches to each side of the surface, in voxels: in the longest of their edges. At
            least 1.5.
        margin: Room around the mesh, as a share of the longest edge of its box: by default 0.05 with a resolution, and
            half the band and a voxel with a spacing.
        device: Where to compute; by default a GPU if there is one. The band stays there.
        orient: As for `sdm.signed_distance_map`.
        sign: `"winding"`, `"flood"` or `"none"`, as for `sdm.signed_distance_map`. A flood goes through a band of half
            the hole size and 3 diagonals of a voxel more, and takes about 16 bytes for each of its voxels.
        hole_size: Of a flood, as there: by default two voxels.

    Returns:
        The band. Its values are those of `sdm.signed_distance_map` on the same grid, clamped to the width, bit for bit,
        without gradients; that map is never made.

    Warns:
        SDMWarning: The band is probably not what was meant, as for `sdm.signed_distance_map`; on a CPU alone.

    Raises:
        DeviceError: The device is not there.
        GridError: Nothing says what the grid is, or several things do; or the band is too narrow, or does not fit into
            memory.
        MeshError: What is given is no mesh, or one that cannot be used.
        SDMError: A sign that there is not, or a hole size without a flood.
    """
    sized: dict[str, Any] = {"spacing": spacing, "resolution": resolution, "margin": margin}
    if are_meshes(mesh):
        meshes = list(mesh)
        method = band_method(half_width, sign, hole_size)
        pairs = zip(meshes, _grids_of(grid, len(meshes)), strict=True)
        return [_band(*_asked(*pair, half_width, device, sized), half_width, orient, method) for pair in pairs]
    method = band_method(half_width, sign, hole_size)
    return _band(*_asked(mesh, grid, half_width, device, sized), half_width, orient, method)


def _asked(
    mesh: Any, grid: Any, half_width: float, device: str | torch.device | None, sized: dict[str, Any]
) -> tuple[TriangleMesh, Grid]:
    """The mesh, on its device, and the grid of a band."""
    if not isinstance(mesh, TriangleMesh):
        mesh = as_mesh(mesh)
    chosen = band_grid(mesh, grid, half_width=half_width, **sized)
    refuse_other_modes(mesh.vertices)
    return mesh.to(choose_device(device, mesh.vertices)), chosen


def _band(there: TriangleMesh, chosen: Grid, half_width: float, orient: Orient, method: SignMethod) -> SparseSDM:
    """The band of a mesh, on its device, whose options were checked."""
    sign = method.sign
    if sign != "winding" or orient != "keep" or not repeated_bands.is_recordable(there):
        return band_of(MeshIndex(there, there.device, orient=orient), chosen, half_width, method)
    width = band_width(chosen, half_width)
    found = repeated_bands.replayed(there, chosen, width)
    if found is not None and found.runs is not None:
        return SparseSDM(found.blocks, found.values, found.runs, chosen, width, 0, sign)
    return band_of(MeshIndex(there, there.device), chosen, half_width, method, there)


def band_width(grid: Grid, half_width: float) -> float:
    """Reach of a band in the mesh's unit: in float32, as its values are."""
    return float(np.float32(half_width * max(grid.spacing)))


def band_of(
    index: MeshIndex, grid: Grid, half_width: float, method: SignMethod, repeated: TriangleMesh | None = None
) -> SparseSDM:
    """The band of an index on a grid, whose options were checked.

    `repeated`: the mesh, if bands of its kind may be recorded.
    """
    width, sign = band_width(grid, half_width), method.sign
    if sign == "flood":
        hole = method.hole_on(grid)
        band = SparseSDM(*flood_band(index, grid, width, hole), grid, width, None, sign, hole)
        return _looked_at(band, index)
    signed = sign == "winding" and index._repeated is None
    gaps = signed and index.closed
    found = measured_blocks(index._structure, grid, width, signed=signed, mesh=index._measured, gaps=gaps)
    blocks, values = found.blocks, found.values
    if repeated is not None and gaps:
        repeated_bands.note(repeated, grid, width, found)
    ambiguous = found.ambiguous if signed and not index.closed else 0
    if sign == "winding" and index._repeated is not None:
        ambiguous = index._repeated.sign_blocks(values, blocks, grid, width)
    if sign == "none":
        return SparseSDM(blocks, values, blocks.new_empty((0, 4)), grid, width, None, sign)
    inside = inside_runs(index, grid, blocks, found.runs, beyond=found.beyond)
    return _looked_at(SparseSDM(blocks, values, inside, grid, width, ambiguous, sign), index)


def _looked_at(band: SparseSDM, index: MeshIndex) -> SparseSDM:
    """The band, of which it was said if it is probably not what was meant."""
    if index._check is not None and band.device.type == "cpu":
        # On a GPU it would be waited for.
        there = len(band.inside) > 0 or bool((band.values < 0).any())
        index._check.look_at(index._measured, band.grid, there, band.sign or "none")
    return band


def band_method(half_width: float, sign: Sign, hole_size: float | None = None) -> SignMethod:
    """The method that signs a band; refuses options that make no sense.

    Raises:
        GridError: The band is too narrow.
        SDMError: A sign that there is not, or a hole size without a flood.
    """
    if not LEAST_HALF_WIDTH <= real(half_width) < math.inf:
        raise GridError(f"half_width is {half_width!r}; give a number of voxels of at least {LEAST_HALF_WIDTH}")
    return SignMethod(sign, hole_size)


def band_grid(
    mesh: TriangleMesh,
    grid: BandGrid | None,
    *,
    half_width: float,
    spacing: float | Sequence[float] | None = None,
    resolution: int | Sequence[int] | None = None,
    margin: float | None = None,
) -> Grid:
    """The grid that a call asks for, see `narrow_band`.

    Raises:
        GridError: None or several of grid, spacing and resolution, or nothing that is one.
    """
    given = [value for value in (grid, spacing, resolution) if value is not None]
    if len(given) != 1:
        raise GridError("a band needs one of these: a Grid, the spacing of its voxels, or a resolution")
    if isinstance(grid, Grid):
        if margin is not None:
            raise GridError("a margin is for grids that a spacing or a resolution describes: give the Grid alone")
        return grid
    if grid is not None:
        if not isinstance(grid, int | float | np.number | Sequence | np.ndarray) or isinstance(grid, str | bytes):
            raise GridError(
                f"an object of type {type(grid).__name__} is no grid: give a Grid, a spacing or a resolution"
            )
        if _are_whole(grid):
            resolution = grid  # type: ignore[assignment]
        else:
            spacing = grid
    if resolution is not None:
        return Grid.around(mesh, resolution, margin=0.05 if margin is None else margin)
    if margin is None and spacing is not None:
        steps = [real(step) for step in np.atleast_1d(np.asarray(spacing, dtype=object))]
        low, high = mesh.bounds
        extent = float((high - low).max())
        room = (half_width + 1) * max(steps, default=0.0)
        margin = room / extent if extent > 0 and math.isfinite(room) else 0.0
    return Grid.around(mesh, spacing=spacing, margin=0.0 if margin is None else margin)


def _are_whole(numbers: Any) -> bool:
    """True for whole numbers by their type: 2 is two voxels, and 2.0 a length."""
    try:
        for number in np.atleast_1d(np.asarray(numbers)).tolist():
            operator.index(number)
    except TypeError:
        return False
    return True


def _grids_of(grid: Any, count: int) -> list[Any]:
    """A grid for each mesh of a list."""
    if not (isinstance(grid, Sequence) and len(grid) > 0 and all(isinstance(each, Grid) for each in grid)):
        return [grid] * count
    if len(grid) != count:
        raise GridError(f"there are {count} meshes and {len(grid)} grids: give one for each, or one for all")
    return list(grid)
