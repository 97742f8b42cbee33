"""Smooth closed surfaces from labels, without the steps of the voxels."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from sdm.core.given_values import real
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine.api import signed_distance_map
from sdm.engine.distance_transform import euclidean_distance_transform, spacing_of
from sdm.errors import GridError, SDMError

# Deviations of the Gaussian that it is cut off at, and that the volume gets as room on each side.
CUT = 4.0
# Surfaces that are tried for the right volume, and the share of it that is close enough.
STEPS, CLOSE = 5, 1e-4
# Largest deviation, as a share of a label's longest edge, or in voxels: beyond it no shape is left, and room for it is
# many times the volume.
MOST_SMOOTHING = (0.25, 4.0)


def label_surface(
    mask: Tensor,
    spacing_mm: float | tuple[float, float, float],
    *,
    smoothing_mm: float = 1.25,
    every_part: bool = False,
) -> TriangleMesh:
    """The smooth surface of a label volume: a level set of its smoothed signed distance, of the label's volume.

    1. The exact signed distance from the surface made of voxel faces, with background around the volume.
    2. A Gaussian over it, which takes away steps of voxels and whatever is thinner than about its width.
    3. The level that encloses the label's volume, since smoothing alone would shrink curved surfaces.
    4. Marching cubes there; the component of the largest volume.

    Args:
        mask: (x,y,z), foreground not zero.
        spacing_mm: Size of a voxel along each axis in mm, or one number.
        smoothing_mm: Standard deviation of the Gaussian in mm.
        every_part: Keep all components.

    Returns:
        A closed mesh in mm, facing outward; voxel (0,0,0) has its centre at the origin.

    Raises:
        SDMError: The label is empty, or the smoothing is not positive, or wider than the label.
        GridError: The spacing is not positive, or the mask is not a volume.
    """
    from scipy.ndimage import gaussian_filter

    size = spacing_of(spacing_mm)
    if not isinstance(mask, Tensor) or mask.ndim != 3:
        raise GridError(f"an object of type {type(mask).__name__} is no volume: give a tensor (x,y,z)")
    if not real(smoothing_mm) > 0:
        raise SDMError(f"a smoothing of {smoothing_mm!r} mm is not positive; half a voxel or more is useful")
    inside = mask.detach() != 0
    if not bool(inside.any()):
        raise SDMError("the label is empty, so it has no surface; give a volume with foreground")
    places = inside.nonzero()
    edge = float(((places.amax(0) - places.amin(0) + 1).cpu() * torch.tensor(size)).max())
    if smoothing_mm > max(MOST_SMOOTHING[0] * edge, MOST_SMOOTHING[1] * max(size)):
        raise SDMError(
            f"a smoothing of {smoothing_mm:g} mm leaves nothing of a label that is {edge:.4g} mm long; about a voxel "
            "takes the steps away"
        )
    room = [int(np.ceil(CUT * smoothing_mm / s)) + 1 for s in size]
    padded = pad(inside.byte(), [n for axis in reversed(room) for n in (axis, axis)])
    values = euclidean_distance_transform(padded, size, signed=True, surface="faces").cpu()
    smooth = gaussian_filter(values.numpy(), [smoothing_mm / s for s in size], truncate=CUT, mode="nearest")
    origin = [-n * s for n, s in zip(room, size, strict=True)]
    grid = Grid(origin, size, smooth.shape)
    mesh = _of_volume(SDM(torch.from_numpy(smooth), grid), int(inside.sum()))
    return mesh if every_part else largest_component(mesh)


def label_map(mask: Tensor, grid: Grid, *, smoothing: float) -> SDM:
    """The exact signed distance map of a label's smooth surface, all parts of it, on the label's own grid and device.

    Args:
        mask: (nx,ny,nz), foreground not zero.
        grid: Where its voxels are.
        smoothing: As `smoothing_mm` of `label_surface`, in the grid's unit.

    Raises:
        SDMError: As `label_surface`.
    """
    mesh = label_surface(mask, grid.spacing, smoothing_mm=smoothing, every_part=True)
    turn = torch.tensor(grid.direction, dtype=torch.float64, device=mesh.device)
    shift = torch.tensor(grid.origin, dtype=torch.float64, device=mesh.device)
    faces = mesh.faces if float(torch.linalg.det(turn)) > 0 else mesh.faces.flip(1)
    placed = TriangleMesh(mesh.vertices.double() @ turn.T + shift, faces, "the label's surface")
    return signed_distance_map(placed, grid, device=mask.device)


def _of_volume(field: SDM, voxels: int) -> TriangleMesh:
    """The level set of the volume of so many voxels: secant steps from the level below which there are as many."""
    values = field.values.reshape(-1).numpy()
    below, above = np.partition(values, (voxels - 1, voxels))[voxels - 1 : voxels + 1]
    wanted = voxels * float(np.prod(field.grid.spacing))
    # Halfway between two values, so that no voxel lies on the level itself.
    level, last = float((np.float64(below) + above) / 2), (0.0, 0.0)
    mesh = field.to_mesh(level)
    for step in range(STEPS):
        volume, area = _volume_and_area(mesh)
        if abs(volume - wanted) <= CLOSE * wanted:
            break
        # A level moves the surface by as much where the map is still a distance.
        slope = (volume - last[1]) / (level - last[0]) if step else area
        last = (level, volume)
        level += (wanted - volume) / slope
        mesh = field.to_mesh(level)
    return mesh


def _volume_and_area(mesh: TriangleMesh) -> tuple[float, float]:
    vertices, faces = mesh.numpy()
    a, b, c = vertices.astype(np.float64)[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    return float((a * normals).sum() / 6), float(np.linalg.norm(normals, axis=1).sum() / 2)


def largest_component(mesh: TriangleMesh) -> TriangleMesh:
    """The connected part of a closed mesh that encloses most, with the vertices that it uses, on the CPU."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    vertices, faces = mesh.numpy()
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    links = coo_array((np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(len(vertices),) * 2)
    part = connected_components(links, directed=False)[1][faces[:, 0]]
    a, b, c = vertices.astype(np.float64)[faces].transpose(1, 0, 2)
    volume = np.bincount(part, (a * np.cross(b, c)).sum(1) / 6)
    kept = faces[part == np.abs(volume).argmax()]
    used, renumbered = np.unique(kept, return_inverse=True)
    return TriangleMesh(vertices[used], renumbered.reshape(-1, 3).astype(np.int32), mesh.name, check=False)
