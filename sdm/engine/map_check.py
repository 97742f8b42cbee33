"""Check of maps that are probably not what was meant: one warning, which says what it looks like and what to do.

It costs nothing on the way: on a CPU it runs once a map is there, and for most meshes ends with a count of the negative
values and a quick look, remembered from call to call; on a GPU it waits until something of the map is read on the host.
Maps that gradients flow through are never checked; of a list of meshes each is. Values that are plain tensors, of
points, batches, slabs and streams, are looked at by less: see `ValuesCheck`.
"""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.errors import SDMWarning
from sdm.inspect.placement import (
    misses,
    placement_problems,
    points_problems,
    resolves,
    rounding_problems,
    thinness,
    too_large_for,
)
from sdm.inspect.problems import FLOOD, NOTHING_INSIDE, ORIENT_PARTS
from sdm.inspect.quick_look import look_at
from sdm.inspect.recommendation import NEARLY_CLOSED
from sdm.inspect.report import inspect_mesh
from sdm.runtime.host_copy import HostCopy
from sdm.runtime.operators import is_eager

NOTHING_SHUT_OFF = (
    "nothing is inside: the flood comes everywhere, through gaps that are not narrower than hole_size; give a larger "
    "one (--hole-size), or the mesh encloses nothing"
)
INSIDE_OUT = "nothing is inside: the mesh is inside out; swap two columns of its faces"
# A mesh that encloses less than minus this share of its box is inside out if nothing is inside it.
LEAST_ENCLOSED = 0.01
# Of more triangles together it looks at the first meshes.
MOST_TRIANGLES = 1 << 18
# Fewer points than this make no box to compare with.
FEWEST_POINTS = 8
PACKAGE = str(Path(__file__).parents[1])


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
        return [] if inside_voxels else placement_problems(*mesh.bounds, grid) or [NOTHING_SHUT_OFF]
    found = [text for text in look_at(mesh).problems(mesh) if not inside_voxels or text != NOTHING_INSIDE]
    if lost := rounding_problems(grid):
        # Whatever else there is may come of it.
        return lost
    if inside_voxels:
        return found or (too_large_for(*mesh.bounds, grid) if inside_voxels == grid.size else [])
    # A mesh that is inside out may lie elsewhere, too: by an axis that is mirrored, or by two that are swapped.
    misplaced = placement_problems(*mesh.bounds, grid)
    return misplaced + found or _though_closed(mesh, grid)


def _though_closed(mesh: TriangleMesh, grid: Grid) -> list[str]:
    """Said of a mesh of which nothing is inside although it has hardly a gap."""
    thin = thinness(*mesh.bounds, grid)
    if thin is None and not resolves(*mesh.bounds, grid):
        return []
    shut = inspect_mesh(mesh).shut_area
    if shut < NEARLY_CLOSED:
        return []
    if thin is not None:
        return [thin]
    text = (
        f"nothing is inside although components that are closed, or open by little, make up {100 * shut:.3g} % of the "
        f"area: they are thinner than the voxels, or faces face all ways; use a finer grid, {ORIENT_PARTS} or {FLOOD}"
    )
    return [text]


class _Warnings(threading.local):
    are_off: bool = False
    prefix: str = ""


_warnings = _Warnings()


@contextmanager
def quiet() -> Iterator[None]:
    """Maps that this thread makes meanwhile are not checked."""
    before, _warnings.are_off = _warnings.are_off, True
    try:
        yield
    finally:
        _warnings.are_off = before


@contextmanager
def named(prefix: str) -> Iterator[None]:
    """Warnings about maps that this thread makes meanwhile begin with this."""
    before, _warnings.prefix = _warnings.prefix, prefix
    try:
        yield
    finally:
        _warnings.prefix = before


class MapCheck:
    """Check of maps that one caller makes of a mesh, wherever its vertices move: it warns once."""

    def __init__(self) -> None:
        self._said = False

    def attach(self, field: SDM, mesh: TriangleMesh) -> SDM:
        """Check a map of a mesh now if it is on the host, else when it is read, and keep the mesh until then."""
        if self._said or not is_eager(mesh.vertices) or any(t.is_inference() for t in (mesh.vertices, mesh.faces)):
            return field
        sign, prefix = field.sign, _warnings.prefix
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
        if self._said or _warnings.are_off:
            return
        found = doubts_about(mesh, grid, inside_voxels, sign)
        self._said = bool(found)
        if found:
            warn(f"{_warnings.prefix}{mesh.name}: {'; '.join(found)}")


class ValuesCheck:
    """Check of plain tensors that one caller makes: it warns once, where nothing at all is inside a mesh.

    Of the first values it looks at the least of each mesh, its box and its volume. On a CPU that is done at once. On a
    GPU these few numbers come to the host behind the work that is queued, and a later call looks at them if they are
    there by then; nothing waits for them.
    """

    def __init__(self) -> None:
        # Where the values were measured that were looked at last.
        self.grid: Grid | None = None
        # Of a look that has not ended.
        self.found: HostCopy[np.ndarray] | None = None
        self._prefix = ""

    def look_at_maps(
        self,
        vertices: Tensor,
        faces: Tensor,
        grid: Grid,
        maps: Tensor | None,
        sign: str,
    ) -> None:
        """Look at maps of meshes that share their faces, or at the first of them if these are large.

        Args:
            vertices: (B,V,3), of each mesh.
            faces: (F,3), of all.
            grid: Where they were measured.
            maps: Their values (B,...); None if they are not all there, so that only a mesh outside the grid counts.
            sign: Their method.
        """
        self.grid = grid
        if sign == "none" or _warnings.are_off or not is_eager(vertices) or _is_capturing(vertices):
            return
        vertices = vertices[: max(1, MOST_TRIANGLES // len(faces))]
        corners = vertices[:, faces.reshape(-1).long()]
        low, high = corners.amin(1), corners.amax(1)
        a, b, c = (corners - 0.5 * (low + high)[:, None]).unflatten(1, (-1, 3)).unbind(2)
        volume = (a * torch.linalg.cross(b, c)).sum((1, 2)) / 6
        if sign == "flood":
            # The way that faces face does not matter.
            volume = volume.abs()
        least = volume * torch.nan if maps is None else maps[: len(vertices)].flatten(1).amin(1).to(volume.dtype)
        numbers = torch.cat([least[:, None], low, high, volume[:, None]], 1)
        self._prefix = _warnings.prefix
        self.found = HostCopy(numbers, Tensor.numpy)
        self.end()

    def end(self) -> None:
        """End a look, if there is one and its numbers have come."""
        if self.found is None or self.grid is None or not self.found.is_there():
            return
        found, self.found = self.found.wait().astype(np.float64), None
        for number, (least, *box, volume) in enumerate(found):
            low, high = np.array(box[:3]), np.array(box[3:])
            if not (np.isfinite(box).all() and (least >= 0 or (np.isnan(least) and misses(low, high, self.grid)))):
                continue
            problems = placement_problems(low, high, self.grid)
            if not problems and volume < -LEAST_ENCLOSED * float(np.prod(high - low)):
                problems = [INSIDE_OUT]
            if problems:
                warn(f"{self._prefix}{f'mesh {number}: ' if len(found) > 1 else ''}{problems[0]}")
                return


# By the faces that a batch shares.
batch_checks: WeakIdKeyDictionary = WeakIdKeyDictionary()


def look_at_batch(vertices: Tensor, faces: Tensor, grid: Grid, values: Tensor, sign: str) -> None:
    """Look once at the maps (B,nx,ny,nz) of meshes that share these faces, on this grid."""
    check: ValuesCheck | None = batch_checks.get(faces)
    if check is None:
        check = batch_checks[faces] = ValuesCheck()
    if check.found is not None:
        check.end()
    elif check.grid is not grid:
        check.look_at_maps(vertices, faces, grid, values, sign)


def _is_capturing(tensor: Tensor) -> bool:
    return tensor.is_cuda and torch.cuda.is_current_stream_capturing()


class SlabsCheck:
    """Check of a map that is given slab by slab: as `ValuesCheck`, on a GPU of the mesh's box alone.

    Args:
        mesh: The mesh as it is measured.
        grid: The whole grid.
        sign: The method.
    """

    def __init__(self, mesh: TriangleMesh, grid: Grid, sign: str) -> None:
        self._what = mesh.vertices[None], mesh.faces, grid
        self._name, self._sign, self._check = mesh.name, sign, ValuesCheck()
        self._least: list[Tensor] = []
        if mesh.vertices.is_cuda:
            self._look(None)

    def _look(self, values: Tensor | None) -> None:
        with named(f"{_warnings.prefix}{self._name}: "):
            self._check.look_at_maps(*self._what, values, self._sign)

    def add(self, values: Tensor) -> None:
        """Take note of a slab."""
        if not values.is_cuda and not values.requires_grad:
            self._least.append(values.amin())

    def end(self) -> None:
        """All slabs were given."""
        if self._least:
            self._look(torch.stack(self._least)[None])
        self._check.end()


def look_at_points(mesh: TriangleMesh, points: Any, found: Any, sign: str) -> bool:
    """Warn if no point is inside, by axes or unit or as the mesh is inside out; of values on a CPU.

    Args:
        mesh: The mesh as it was measured.
        points: As they were given.
        found: Their distances, or these and the closest points.
        sign: The method.

    Returns:
        True if there was something to say.
    """
    values: Tensor = found if isinstance(found, Tensor) else found[0]
    if sign == "none" or values.is_cuda or _warnings.are_off or values.numel() < FEWEST_POINTS:
        return False
    if not is_eager(mesh.vertices, values) or not float(values.amin()) >= 0:
        return False
    at = torch.as_tensor(points, device=values.device).detach().reshape(-1, 3)
    begin, end = (corner.double().numpy() for corner in (at.amin(0), at.amax(0)))
    problems = points_problems(*mesh.bounds, begin, end) or look_at(mesh).problems(mesh)
    if problems:
        warn(f"{_warnings.prefix}{mesh.name}: {'; '.join(problems)}")
    return bool(problems)


def later_check(mesh: TriangleMesh, prefix: str, sign: str) -> Callable[[Grid, int], None] | None:
    """Check of one map of a mesh that nobody watches, for a map that is read on the host later."""
    vertices, faces = mesh.vertices, mesh.faces
    if _warnings.are_off or vertices.is_inference() or faces.is_inference():
        return None
    return partial(_look, mesh, prefix, sign, vertices._version, faces._version)


def one_check(mesh: TriangleMesh, sign: str) -> Callable[[Grid, int], None] | None:
    """`MapCheck` of one map of an eager mesh on a GPU, in fewer steps."""
    vertices, faces = mesh.vertices, mesh.faces
    if vertices.is_inference() or faces.is_inference():
        return None
    return partial(_look, mesh, _warnings.prefix, sign, vertices._version, faces._version)


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


def warn(message: str) -> None:
    """Warn whoever called the library, wherever in it this is."""
    level, frame = 1, sys._getframe()
    while frame is not None and frame.f_code.co_filename.startswith(PACKAGE):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, SDMWarning, stacklevel=level)
