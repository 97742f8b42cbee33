"""Check of values that are plain tensors, of points, batches, slabs and streams: by less than a map is looked at by.

Of maps `sdm.engine.checks.map_check` says more.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.checks.caller_warning import named, state, warn
from sdm.engine.checks.digits_check import look_at_digits
from sdm.inspect.placement import misses, placement_problems, points_problems
from sdm.inspect.quick_look import look_at
from sdm.runtime.host_copy import HostCopy
from sdm.runtime.operators import is_eager

INSIDE_OUT = "nothing is inside: the mesh is inside out; swap two columns of its faces"
# A mesh that encloses less than minus this share of its box is inside out if nothing is inside it.
LEAST_ENCLOSED = 0.01
# Of more triangles together it looks at the first meshes.
MOST_TRIANGLES = 1 << 18
# Fewer points than this make no box to compare with.
FEWEST_POINTS = 8


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
        if sign == "none" or state.are_off or not is_eager(vertices) or _is_capturing(vertices):
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
        self._prefix = state.prefix
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
        with named(f"{state.prefix}{self._name}: "):
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
    """Warn if float32 rounds the mesh, or no point is inside, by axes or unit or as it is inside out; on a CPU.

    Args:
        mesh: The mesh as it was measured.
        points: As they were given.
        found: Their distances, or these and the closest points.
        sign: The method.

    Returns:
        True if there was something to say.
    """
    values: Tensor = found if isinstance(found, Tensor) else found[0]
    if sign == "none" or values.is_cuda or state.are_off or values.numel() < FEWEST_POINTS:
        return False
    if not is_eager(mesh.vertices, values):
        return False
    if look_at_digits(mesh):
        return True
    if not float(values.amin()) >= 0:
        return False
    at = torch.as_tensor(points, device=values.device).detach().reshape(-1, 3)
    begin, end = (corner.double().numpy() for corner in (at.amin(0), at.amax(0)))
    problems = points_problems(*mesh.bounds, begin, end) or look_at(mesh).problems(mesh)
    if problems:
        warn(f"{state.prefix}{mesh.name}: {'; '.join(problems)}")
    return bool(problems)
