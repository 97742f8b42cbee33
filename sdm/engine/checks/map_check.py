"""Check of maps that are probably not what was meant: one warning, which says what it looks like and what to do.

It costs nothing on the way: on a CPU it runs once a map is there, and for most meshes ends with a count of the negative
values and a quick look, remembered from call to call; on a GPU it waits until something of the map is read on the host.
Maps that gradients flow through are never checked; of a list of meshes each is. Values that are plain tensors, of
points, batches, slabs and streams, are looked at by less: see `sdm.engine.checks.values_check`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine.checks.caller_warning import state, warn
from sdm.engine.checks.values_check import look_at_points
from sdm.inspect.placement import (
    placement_problems,
    resolves,
    rounding_problems,
    thinness,
    too_large_for,
)
from sdm.inspect.problems import FLOOD, NOTHING_INSIDE, ORIENT_PARTS
from sdm.inspect.quick_look import look_at
from sdm.inspect.recommendation import NEARLY_CLOSED
from sdm.inspect.report import inspect_mesh
from sdm.runtime.operators import is_eager

NOTHING_SHUT_OFF = (
    "nothing is inside: the flood comes everywhere, through gaps that are not narrower than hole_size; give a larger "
    "one (--hole-size), or the mesh encloses nothing"
)


def doubts_about(mesh: TriangleMesh, grid: Grid, inside_voxels: int, sign: str | None = "winding") -> list[str]:
    """Sentences about why a map is probably not what was meant, the gravest first; none for most.

    Args:
        mesh: The mesh as it was measured.
        grid: Where.
        inside_voxels: How many values are negative.
        sign: The method that said so. Without one there is no doubt about it.
    """
    if sign == "none":
        return []
    if sign == "flood":
        # The way that faces face does not matter.
        return [] if inside_voxels else placement_problems(*mesh.bounds, grid) or _nothing_flooded(mesh, grid)
    found = [text for text in look_at(mesh).problems(mesh) if not inside_voxels or text != NOTHING_INSIDE]
    if lost := rounding_problems(grid):
        # Whatever else there is may come of it.
        return lost
    if inside_voxels:
        return found or (too_large_for(*mesh.bounds, grid) if inside_voxels == grid.size else [])
    # A mesh that is inside out may lie elsewhere, too: by an axis that is mirrored, or by two that are swapped.
    misplaced = placement_problems(*mesh.bounds, grid)
    return misplaced + found or _though_closed(mesh, grid)


def _nothing_flooded(mesh: TriangleMesh, grid: Grid) -> list[str]:
    """Said of a mesh whose flood comes everywhere: a closed one has no gap, and no room for a voxel."""
    report, thin = inspect_mesh(mesh), thinness(*mesh.bounds, grid)
    if report.shut_area < NEARLY_CLOSED or report.volume == 0 or not (thin or report.closed):
        return [NOTHING_SHUT_OFF]
    text = f"{_thin_walls(grid)}, or fill what it walls in by a hole_size (--hole-size) above the width of the opening"
    return [thin or text]


def _thin_walls(grid: Grid) -> str:
    return (
        f"nothing is inside although the mesh is closed: it is thinner than the voxels, {max(grid.spacing):.3g}; use a "
        "finer grid"
    )


def _though_closed(mesh: TriangleMesh, grid: Grid) -> list[str]:
    """Said of a mesh of which nothing is inside although it has hardly a gap."""
    thin = thinness(*mesh.bounds, grid)
    if thin is None and not resolves(*mesh.bounds, grid):
        return []
    report = inspect_mesh(mesh)
    shut = report.shut_area
    if shut < NEARLY_CLOSED:
        return []
    if thin is not None or report.closed:
        return [thin or _thin_walls(grid)]
    text = (
        f"nothing is inside although components that are closed, or open by little, make up {100 * shut:.3g} % of the "
        f"area: they are thinner than the voxels, or faces face all ways; use a finer grid, {ORIENT_PARTS} or {FLOOD}"
    )
    return [text]


class MapCheck:
    """Check of maps that one caller makes of a mesh, wherever its vertices move: it warns once."""

    def __init__(self) -> None:
        self._said = False

    def attach(self, field: SDM, mesh: TriangleMesh) -> SDM:
        """Check a map of a mesh now if it is on the host, else when it is read, and keep the mesh until then."""
        if self._said or not is_eager(mesh.vertices) or any(t.is_inference() for t in (mesh.vertices, mesh.faces)):
            return field
        sign, prefix = field.sign, state.prefix
        states = mesh.vertices._version, mesh.faces._version

        def check(grid: Grid, inside_voxels: int) -> None:
            # Of vertices that were moved in place since, nobody knows how they faced.
            if not self._said and states == (mesh.vertices._version, mesh.faces._version):
                found = doubts_about(mesh, grid, inside_voxels, sign)
                self._said = bool(found)
                if found:
                    warn(f"{prefix}{mesh.name}: {'; '.join(found)}")

        return field.checked_by(check)

    def look_at_points(self, mesh: TriangleMesh, points: Any, found: Any, sign: str) -> None:
        """Warn about a mesh with no point inside, if nobody was warned yet; see the function of this name."""
        self._said = self._said or look_at_points(mesh, points, found, sign)

    def look_at(self, mesh: TriangleMesh, grid: Grid, inside_voxels: int, sign: str) -> None:
        """Warn about a mesh whose map is there, if nobody was warned yet; see `doubts_about`."""
        if self._said or state.are_off:
            return
        found = doubts_about(mesh, grid, inside_voxels, sign)
        self._said = bool(found)
        if found:
            warn(f"{state.prefix}{mesh.name}: {'; '.join(found)}")


def later_check(mesh: TriangleMesh, prefix: str, sign: str) -> Callable[[Grid, int], None] | None:
    """Check of one map of a mesh that nobody watches, for a map that is read on the host later."""
    vertices, faces = mesh.vertices, mesh.faces
    if state.are_off or vertices.is_inference() or faces.is_inference():
        return None
    return partial(_look, mesh, prefix, sign, vertices._version, faces._version)


def one_check(mesh: TriangleMesh, sign: str) -> Callable[[Grid, int], None] | None:
    """`MapCheck` of one map of an eager mesh on a GPU, in fewer steps."""
    vertices, faces = mesh.vertices, mesh.faces
    if vertices.is_inference() or faces.is_inference():
        return None
    return partial(_look, mesh, state.prefix, sign, vertices._version, faces._version)


def _look(
    mesh: TriangleMesh, prefix: str, sign: str, vertices: int, faces: int, grid: Grid, inside_voxels: int
) -> None:
    if (vertices, faces) == (mesh.vertices._version, mesh.faces._version):
        found = doubts_about(mesh, grid, inside_voxels, sign)
        if found:
            warn(f"{prefix}{mesh.name}: {'; '.join(found)}")


def checked(check: MapCheck | None, field: SDM, mesh: TriangleMesh) -> SDM:
    """The map of a mesh, with a check attached if there is one."""
    return field if check is None else check.attach(field, mesh)
