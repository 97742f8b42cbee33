"""Signs by a flood: outside is what a ball reaches from beyond the mesh's box, and whatever leads uphill to that.

1. The ball's centre moves from voxel to voxel wherever it surely stays a radius away from the surface
   (`reached_region`): so it passes no gap that is narrower than the ball.
2. What it did not reach is near the surface, or inside. Each such voxel goes uphill, away from the surface and without
   crossing it (`uphill_links`, `off_grid_climb`), to a voxel that the ball reached, and then it is outside; or to where
   nothing rises, and then it is inside.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.flood.flood_grid import FloodGrid
from sdm.kernels.flood.off_grid_climb import Walls, climb, linked
from sdm.kernels.flood.reached_region import REACHED, find_reached
from sdm.kernels.flood.uphill_links import StuckVoxels, link_uphill
from sdm.kernels.launch import launch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _negate_inside(
    begin: int,
    shape: wp.vec3i,
    wide: wp.vec3i,
    skipped: wp.vec3i,
    links: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
):
    at = begin + wp.tid()
    k = at % shape[2] + skipped[2]
    row = at / shape[2]
    j = row % shape[1] + skipped[1]
    i = row / shape[1] + skipped[0]
    number = (i * wide[1] + j) * wide[2] + k
    link = linked(links, number)
    while link != number and link != REACHED:
        number = link
        link = linked(links, number)
    if link != REACHED:
        values[at] = -wp.abs(values[at])


def flood_signs(
    walls: Walls,
    grid: FloodGrid,
    distances: wp.array,
    near: wp.array,
    links: wp.array,
    stuck: StuckVoxels,
    values: wp.array,
    shape: tuple[int, int, int],
    skipped: tuple[int, int, int],
) -> None:
    """Negate the values of all voxels inside.

    Args:
        walls: The surface.
        grid: The voxels of the flood, of which voxel 0 is beyond the mesh's box.
        distances: (N,) float32, unsigned, to the mesh.
        near: (N,) float32, the same to the mesh and what closes its small holes; may be the same array.
        links: (N,) int32, workspace.
        stuck: Workspace, of any size.
        values: Voxels (nx,ny,nz), flat: those of the flood's grid that lie within some layers of it.
        shape: (nx,ny,nz).
        skipped: Layers before them along each axis.
    """
    find_reached(grid, distances, links)
    link_uphill(grid, near, links, stuck)
    climb(walls, grid, near, links, stuck)
    inputs = [wp.vec3i(*shape), grid.shape, wp.vec3i(*skipped), links, values]
    launch(_negate_inside, values.shape[0], inputs, values.device)
