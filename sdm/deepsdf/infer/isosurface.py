"""Isosurface of a learned function, from coarse to fine: only tiles of the grid that it may cross are decoded."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.deepsdf.networks.model import CHUNK, DeepSDF
from sdm.deepsdf.samples import UnitSphere
from sdm.errors import GridError, SDMError

TILE = 8
# How much faster than a distance the function may change before a tile could be missed at first.
SLOPE = 1.5


def decode_mesh(
    model: DeepSDF, code: Any, *, sphere: UnitSphere | None = None, resolution: int = 256, chunk: int = CHUNK
) -> TriangleMesh:
    """The surface that a code says, by marching cubes on a cube of points around the sphere.

    Args:
        model: The decoder.
        code: (D,).
        sphere: Where the shape is; the unit sphere if not given.
        resolution: Points along each axis, at least 16.
        chunk: Points that are decoded at a time.

    Raises:
        SDMError: The code has the wrong size, or there is no surface in the box.
    """
    field = decode_near_surface(model, code, sphere=sphere, resolution=resolution, chunk=chunk)
    return field.to_mesh()


def decode_near_surface(
    model: DeepSDF, code: Any, *, sphere: UnitSphere | None = None, resolution: int = 256, chunk: int = CHUNK
) -> SDM:
    """The map of a code: decoded near the surface, with the right sign everywhere, cut to the box around its inside.

    Args:
        model: A trained model.
        code: (D,) or (1,D).
        sphere: Where the shape was; by default the unit sphere.
        resolution: Voxels along each axis of the sphere's box, of which the box is cut.
        chunk: Points that go through the network at a time.

    Returns:
        The map, negative inside, in the sphere's unit. Further from the surface than some voxels its sign alone counts.

    Raises:
        GridError: A resolution below 16.
        SDMError: The code has no surface, or is another model's.
    """
    z = model.check_codes(code)

    @torch.no_grad()
    def function(points: Tensor) -> Tensor:
        return torch.cat([model.decoder(z, part[None])[0] for part in points.split(chunk)])

    values, refined = refine(function, resolution, model.device)
    step = 2.0 / (resolution - 1)
    inside = (values < 0).nonzero()
    if not len(inside) or not bool(refined.any()):
        raise SDMError("the code has no surface in the unit sphere's box; is it a code of this model?")
    low = (inside.amin(0) - 2).clamp(min=0)
    high = (inside.amax(0) + 3).clamp(max=resolution)
    values = values[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
    sphere = sphere or UnitSphere((0.0, 0.0, 0.0), 1.0)
    origin = [c + sphere.radius * (float(n) * step - 1) for c, n in zip(sphere.centre, low, strict=True)]
    return SDM(sphere.radius * values, Grid(origin, (sphere.radius * step,) * 3, tuple(values.shape)))


def refine(function: Callable[[Tensor], Tensor], resolution: int, device: torch.device | str) -> tuple[Tensor, Tensor]:
    """A function's values on `resolution`^3 points of [-1,1]^3, evaluated only where zero may be near.

    Tiles of 8^3 points begin with the value at their middle. Those where it is small enough for a zero in the tile
    or in the cells that join it to the next ones are evaluated, and then, as long as there are any, those across
    whose face the sign changes. So a surface that was found anywhere is followed to its end.

    Args:
        function: From points (N,3) to values (N,).
        resolution: Points along each axis, at least 16.
        device: Where to compute.

    Returns:
        Values (n,n,n), and which of the tiles (m,m,m) were evaluated.

    Raises:
        GridError: Fewer points.
    """
    if resolution < 2 * TILE:
        raise GridError(f"a resolution of {resolution} is too low for a surface; give {2 * TILE} or more")
    step, tiles = 2.0 / (resolution - 1), -(-resolution // TILE)
    size = tiles * TILE
    every = torch.cartesian_prod(*[torch.arange(tiles, device=device)] * 3)
    middle = function((every.float() * TILE + (TILE - 1) / 2) * step - 1)
    # Values of a view by tile and place in it are values of the whole.
    whole = torch.empty(size, size, size, device=device, dtype=middle.dtype)
    view = whole.view(tiles, TILE, tiles, TILE, tiles, TILE).permute(0, 2, 4, 1, 3, 5)
    view.copy_(middle.reshape(tiles, tiles, tiles, 1, 1, 1).expand_as(view))
    inner = torch.cartesian_prod(*[torch.arange(TILE, device=device)] * 3)
    reach = SLOPE * 3**0.5 * (TILE + 1) / 2 * step
    refined = torch.zeros(tiles, tiles, tiles, dtype=torch.bool, device=device)
    wanted = (middle.abs() <= reach).reshape(refined.shape)
    while bool(wanted.any()):
        chosen = wanted.nonzero()
        points = ((chosen[:, None] * TILE + inner).float() * step - 1).reshape(-1, 3)
        view[wanted] = function(points).reshape(-1, TILE, TILE, TILE)
        refined |= wanted
        wanted = _crossed(whole, tiles) & ~refined
    return whole[:resolution, :resolution, :resolution].contiguous(), refined


def _crossed(whole: Tensor, tiles: int) -> Tensor:
    """Tiles (m,m,m) across one of whose faces the sign changes."""
    inside = whole < 0
    crossed = torch.zeros(tiles, tiles, tiles, dtype=torch.bool, device=whole.device)
    for axis in range(3):
        last = inside.movedim(axis, 0)[TILE - 1 : -1 : TILE]
        first = inside.movedim(axis, 0)[TILE::TILE]
        faces = (last != first).reshape(tiles - 1, tiles, TILE, tiles, TILE).any(4).any(2)
        moved = crossed.movedim(axis, 0)
        moved[:-1] |= faces
        moved[1:] |= faces
    return crossed
