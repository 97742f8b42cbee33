"""One closed, oriented surface of any mesh: an exact map, signs by a flood, and marching cubes at an offset."""

from __future__ import annotations

import math
from typing import Literal, TypedDict, Unpack, get_args, overload

import numpy as np
import torch

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.device import choose_device
from sdm.core.given_values import real
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.arguments import DEFAULT_HOLE, Sign, SignMethod
from sdm.engine.checks.digits_check import look_at_digits
from sdm.engine.mesh_index import MeshIndex
from sdm.engine.surface import Method, check_method
from sdm.errors import GridError, MeshError, SDMError
from sdm.inspect import inspect_mesh, orient_outward
from sdm.inspect.positions import are_distinct
from sdm.inspect.quick_look import look_at
from sdm.remeshing.beads import JOINED, without_beads
from sdm.remeshing.closing_field import closing_field, is_reached, with_zeros_inside
from sdm.remeshing.deviation import SAMPLES, WatertightReport, deviation

Hidden = Literal["drop", "keep"]
# A hundredth more than half a voxel: a sheet midway between two layers of voxels is half a voxel from both.
DEFAULT_OFFSET = 0.505
# Voxels around the surface, so that it ends before the grid does.
BORDER = 2
SMALLEST = 8
FEWEST_SAMPLES = 1000
# Offset in lengths of a mesh beyond which its surface is a ball.
FURTHEST = 10


class SurfaceOptions(TypedDict, total=False):
    """Kind and device of a surface, as the overloads share them."""

    hidden: Hidden
    method: Method
    device: str | torch.device | None


@overload
def watertight(
    mesh: MeshLike,
    resolution: int = 512,
    offset: float | None = None,
    hole_size: float | None = None,
    *,
    return_report: Literal[False] = False,
    **options: Unpack[SurfaceOptions],
) -> TriangleMesh: ...
@overload
def watertight(
    mesh: MeshLike,
    resolution: int = 512,
    offset: float | None = None,
    hole_size: float | None = None,
    *,
    return_report: Literal[True],
    **options: Unpack[SurfaceOptions],
) -> tuple[TriangleMesh, WatertightReport]: ...
def watertight(
    mesh: MeshLike,
    resolution: int = 512,
    offset: float | None = None,
    hole_size: float | None = None,
    *,
    hidden: Hidden = "drop",
    method: Method = "cubes",
    device: str | torch.device | None = None,
    return_report: bool = False,
) -> TriangleMesh | tuple[TriangleMesh, WatertightReport]:
    """One closed surface of any mesh: of sheets, holes, soup, parts that cross, faces that face all ways.

    The exact distance map of the mesh, negative where a flood from outside does not reach, and of that the surface at
    `offset`: where outside is `offset` away from the mesh. A large map on a CPU, or one that does not fit into memory,
    is replaced by a narrow band, with the same surface.

    Args:
        mesh: Any triangles.
        resolution: Voxels along the longest edge of the mesh's box, with the room around it.
        offset: In the mesh's unit, at least 0. By default 0 for a mesh that is closed and signed, else half a voxel, so
            that sheets become plates about a voxel thick. From 0.87 voxels on (half a voxel's diagonal) nothing of a
            mesh is lost, also of wires; with less, what is thinner than a voxel may be, and single voxels beside the
            rim of a sheet, which would be surfaces of their own, are dropped. At most ten times the longest edge of the
            mesh's box.
        hole_size: Gaps that are narrower than this length are closed, where hidden parts are dropped; by default two
            voxels.
        hidden: `"drop"` fills what no way leads into from outside: cavities, and parts inside others. `"keep"` keeps
            cavities: of a closed mesh with faces that agree by winding numbers, once what is inside out is turned; of
            others as the space that is more than `offset` away from all faces.
        method: `"cubes"`, or `"dual"`: dual contouring with the mesh's normals keeps edges and corners sharp; see
            `SDM.to_mesh`.
        device: Where to compute; by default a GPU if there is one.
        return_report: Also return a `WatertightReport`, with the distances between the mesh and its surface.

    Returns:
        The surface, on `device`: each edge has two triangles, one each way, vertices are at places of their own, and
        it faces outward. It may have several parts. A closed mesh comes back within half a voxel where it is smooth at
        that size; tips and sharp corners lose up to two voxels. With `return_report` also its report.

    Raises:
        DeviceError: The device is not there.
        GridError: The map does not fit into memory, or the resolution is too low.
        MeshError: What is given is no mesh, or one of size zero.
        SDMError: Options that make no sense, or a mesh thinner than a voxel with an offset of 0.
    """
    mesh = as_mesh(mesh)
    check_options(resolution, offset, hole_size, hidden, method)
    where = choose_device(device, mesh.vertices)
    look_at_digits(mesh)
    closed, agreeing = closedness(mesh)
    sign = _sign(closed and agreeing, hidden)
    if sign == "winding":
        mesh = orient_outward(mesh)
    longest = float(np.ptp(mesh.bounds, axis=0).max())
    if offset is not None and 0 < FURTHEST * longest < offset:
        raise SDMError(
            f"offset is {offset:g}, and {mesh.name} is {longest:.4g} long: so far out every mesh is a ball; give at "
            f"most {FURTHEST * longest:.4g}, in the mesh's unit"
        )
    # Without a sign nothing is at a distance of 0 or less.
    exact = closed and sign != "none"
    grid = _grid(mesh, resolution, 0.0 if exact and offset is None else offset)
    step = grid.spacing[0]
    level = (0.0 if exact else DEFAULT_OFFSET * step) if offset is None else float(offset)
    gap = None if sign != "flood" else (DEFAULT_HOLE * step if hole_size is None else float(hole_size))
    index = MeshIndex(mesh, where, warn=False)
    field = with_zeros_inside(closing_field(index, grid, sign, gap, level), 1e-6 * step)
    if not is_reached(field, level):
        raise SDMError(
            f"nothing of {mesh.name} is as thick as a voxel of {step:g}: give an offset of at least {step / 2:g}, or a "
            "higher resolution"
        )
    surface = field.to_mesh(level, method=method, mesh=index if method == "dual" else None)
    closed_mesh = TriangleMesh(surface.vertices, surface.faces, mesh.name, check=False)
    if 0 < level < JOINED * step:
        closed_mesh = without_beads(closed_mesh, index)
    if not return_report:
        return closed_mesh
    there = mesh.to(where)
    # From far inside a ball all of it is equally near: each of these takes a look at every triangle.
    inner = min(SAMPLES, max(FEWEST_SAMPLES, round(SAMPLES * (longest / level) ** 2))) if level > 0 else SAMPLES
    return closed_mesh, WatertightReport(
        name=mesh.name,
        triangles=len(mesh),
        closed=closed,
        sign=sign,
        spacing=step,
        shape=grid.shape,
        offset=level,
        hole_size=gap,
        hidden=hidden,
        output_triangles=len(closed_mesh),
        input_to_output=deviation(there, closed_mesh, inner),
        output_to_input=deviation(closed_mesh, there, SAMPLES),
    )


def check_options(
    resolution: int, offset: float | None, hole_size: float | None, hidden: Hidden, method: Method
) -> None:
    """Refuse options of `watertight` that make no sense whatever the mesh.

    Raises:
        GridError: The resolution is too low.
        SDMError: Another option that there is not, or a length that is none.
    """
    if hidden not in get_args(Hidden):
        raise SDMError(f"hidden is {hidden!r}; use 'drop' or 'keep'")
    check_method(method)
    SignMethod("flood", hole_size)
    if hidden == "keep" and hole_size is not None:
        raise SDMError(
            'hole_size is the width of gaps that a flood passes, and hidden="keep" (--hidden keep) has no flood: leave '
            "it out"
        )
    if offset is not None and (isinstance(offset, bool) or not 0 <= real(offset) < math.inf):
        raise SDMError(f"offset is {offset!r}; give a length of at least 0, in the mesh's unit")
    # A text or a truth value is no number of voxels, nor is NaN.
    is_number = isinstance(resolution, int | float | np.number) and not isinstance(resolution, bool)
    if not (is_number and resolution >= SMALLEST and resolution % 1 == 0):
        raise GridError(
            f"the resolution {resolution!r} is too low for a surface; give a whole number from {SMALLEST} on"
        )


def closedness(mesh: TriangleMesh) -> tuple[bool, bool]:
    """True for a mesh without a free edge or a face that is there twice; and True if its faces agree which side is out.

    Most closed meshes are told by one look at their edges, in a tenth of the time of `inspect_mesh`.
    """
    here = mesh.to("cpu")
    if look_at(here).closes_plainly(here) and are_distinct(here.vertices.detach().numpy()):
        return True, True
    found = inspect_mesh(here)
    # Sheets that are there twice have no free edge either, and no inside.
    return found.watertight and found.duplicate_faces == 0, found.closed


def _sign(by_winding: bool, hidden: Hidden) -> Sign:
    if hidden == "drop":
        return "flood"
    return "winding" if by_winding else "none"


def _grid(mesh: TriangleMesh, resolution: int, offset: float | None) -> Grid:
    """Cubic voxels around a mesh, with room for a surface at an offset; None for half a voxel."""
    low, high = mesh.bounds
    size = high - low
    voxels = resolution - 1 - 2 * BORDER - (2 * DEFAULT_OFFSET if offset is None else 0)
    step = float(size.max() + 2 * (offset or 0.0)) / voxels
    if not step > 0:
        raise MeshError(f"{mesh.name} has size zero, so a resolution says nothing: give an offset")
    room = BORDER + (DEFAULT_OFFSET if offset is None else offset / step)
    shape = np.ceil(size / step + 2 * room - 1e-6) + 1
    return Grid((low + high) / 2 - step * (shape - 1) / 2, (step,) * 3, shape)
