"""Surfaces of dense maps and of narrow bands at a level: by which method, and what is refused."""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

from sdm.core.given_values import as_level
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.core.sparse_sdm import SparseSDM
from sdm.engine.surface.dual_contouring import dual_contouring
from sdm.engine.surface.marching_cubes import marching_cubes
from sdm.engine.surface.voxel_blocks import VoxelBlocks, band_blocks, dense_blocks
from sdm.errors import SDMError

Method = Literal["cubes", "dual"]


def check_method(method: Method) -> None:
    """Refuse a method that there is not.

    Raises:
        SDMError: It is one.
    """
    if method not in get_args(Method):
        raise SDMError(f"method is {method!r}; use 'cubes' (marching cubes) or 'dual' (dual contouring)")


def isosurface(field: SDM, level: float, method: Method, mesh: Any) -> TriangleMesh:
    """The surface of a dense map, see `SDM.to_mesh`."""
    level = as_level(level)
    if min(field.shape) < 2:
        raise SDMError(f"a grid of shape {field.shape} is one voxel thin: a surface needs two along each axis")
    found = _surface(dense_blocks(field.values, field.grid), field, level, method, mesh)
    if found is None:
        low, high = (float(bound) for bound in field.values.detach().aminmax())
        raise SDMError(f"the map runs from {low:g} to {high:g}: no surface at level {level:g}")
    return found


def band_isosurface(band: SparseSDM, level: float, method: Method, mesh: Any) -> TriangleMesh:
    """The surface of a narrow band, see `SparseSDM.to_mesh`."""
    level = as_level(level)
    reach = math.hypot(*band.grid.spacing)
    if not abs(level) + reach < band.width:
        raise SDMError(
            f"the band reaches {band.width:g} from the surface, but the cells that the level {level:g} crosses "
            f"{abs(level) + reach:g}: make it wider, or choose a level nearer to 0"
        )
    found = _surface(band_blocks(band), band, level, method, mesh) if len(band) else None
    if found is None:
        raise SDMError(f"the band has no surface at level {level:g}")
    return found


def _surface(
    blocks: VoxelBlocks, field: SDM | SparseSDM, level: float, method: Method, mesh: Any
) -> TriangleMesh | None:
    check_method(method)
    if method == "dual":
        return dual_contouring(blocks, field, level, mesh)
    if mesh is not None:
        raise SDMError("the mesh gives dual contouring its normals: use method='dual', or leave the mesh out")
    return marching_cubes(blocks, level)
