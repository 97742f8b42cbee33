"""Accuracy of a surrogate: errors of the map, of the surface and of the inside, against exact maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh
from sdm.engine.api import signed_distance
from sdm.shapes import make_family
from sdm.surrogate.networks.cochlea_grid import GRID
from sdm.surrogate.train.losses import slopes
from sdm.surrogate.train.validation import validation_batches

NEAR_MM = 0.5


@dataclass
class Accuracy:
    """Errors by shape, each a list over the shapes; lengths in mm. `summary` has the figures of a table."""

    mae: list[float]
    most: list[float]
    mae_near: list[float]
    most_near: list[float]
    dice: list[float]
    slope: list[float]
    surface_mean: list[float]
    surface_95: list[float]

    def summary(self) -> dict[str, float]:
        """Means over shapes; for `max`, `max_near` and `dice_worst` the worst shape; `surface_95`'s mean and worst."""
        t = {key: torch.tensor(values, dtype=torch.float64) for key, values in vars(self).items()}
        return {
            "mae_mm": float(t["mae"].mean()),
            "max_mm": float(t["most"].max()),
            "mae_near_mm": float(t["mae_near"].mean()),
            "max_near_mm": float(t["most_near"].max()),
            "surface_mean_mm": float(t["surface_mean"].mean()),
            "surface_mean_worst_mm": float(t["surface_mean"].max()),
            "surface_95_mm": float(t["surface_95"].mean()),
            "surface_95_worst_mm": float(t["surface_95"].max()),
            "dice_mean": float(t["dice"].mean()),
            "dice_worst": float(t["dice"].min()),
            "slope_error": float(t["slope"].mean()),
        }


@torch.no_grad()
def measure(
    surrogate: Callable[[Tensor], Tensor], theta: Tensor, device: torch.device | str, batch_size: int = 8
) -> Accuracy:
    """Compare a surrogate with the exact engine.

    Args:
        surrogate: Parameters (B,4) to maps (B,1,80,64,40) on `device`.
        theta: (N,4) parameters.
        device: Where to compute both.
        batch_size: Shapes at a time.

    Surface distances are both ways: of points where the predicted map changes sign along the grid's edges to the
    exact mesh, and of the mesh's vertices to the predicted surface, as the predicted map interpolated there. A shape
    whose predicted map has no inside counts with infinite distances.
    """
    family = make_family("cochlea")
    rows = []
    for batch in validation_batches(theta, device, batch_size):
        maps = surrogate(batch.theta).float()
        vertices = family.vertices(batch.theta)
        for exact, map_, own in zip(batch.sdm[:, 0], maps[:, 0], vertices, strict=True):
            mesh = TriangleMesh(own, family.faces_on(own.device), check=False)
            rows.append(torch.stack([*_volume(map_, exact), *_surface(map_, mesh)]))
    return Accuracy(*torch.stack(rows).T.tolist())


def _volume(map_: Tensor, exact: Tensor) -> tuple[Tensor, ...]:
    error = (map_ - exact).abs()
    near = exact.abs() < NEAR_MM
    inside, wanted = map_ < 0, exact < 0
    return (
        error.mean(),
        error.max(),
        (error * near).sum() / near.sum(),
        (error * near).max(),
        2 * (inside & wanted).sum() / (inside.sum() + wanted.sum()),
        (slopes(map_[None, None]) - 1).abs().mean(),
    )


def _surface(map_: Tensor, mesh: TriangleMesh) -> tuple[Tensor, Tensor]:
    points = crossings(map_)
    if not len(points):
        nowhere = torch.full((), torch.inf, device=map_.device)
        return nowhere, nowhere
    there = signed_distance(mesh, points, device=points.device).abs()
    back = interpolated(map_, mesh.vertices).abs()
    return (there.mean() + back.mean()) / 2, torch.quantile(torch.cat([there, back]), 0.95)


def crossings(map_: Tensor) -> Tensor:
    """Points (N,3) [mm] where a map (nx,ny,nz) is zero along the grid's edges, linearly between voxels."""
    points = []
    origin, spacing = (torch.tensor(x, device=map_.device, dtype=map_.dtype) for x in (GRID.origin, GRID.spacing))
    for axis in range(3):
        count = map_.shape[axis]
        low, high = map_.narrow(axis, 0, count - 1), map_.narrow(axis, 1, count - 1)
        at = ((low < 0) != (high < 0)).nonzero()
        a, b = low[tuple(at.T)], high[tuple(at.T)]
        place = at.to(map_.dtype)
        place[:, axis] += a / (a - b)
        points.append(origin + spacing * place)
    return torch.cat(points)


def interpolated(map_: Tensor, points: Tensor) -> Tensor:
    """A map (nx,ny,nz) at points (N,3) [mm] within the grid, trilinearly."""
    at = places_in_map(points).reshape(1, -1, 1, 1, 3).to(map_.dtype)
    return torch.nn.functional.grid_sample(map_[None, None], at, align_corners=True).reshape(-1)


def places_in_map(points: Tensor) -> Tensor:
    """Points (...,3) [mm] as `grid_sample` wants them for maps on `GRID`, their corners aligned."""
    origin, spacing = (torch.tensor(x, device=points.device) for x in (GRID.origin, GRID.spacing))
    last = torch.tensor(GRID.shape, device=points.device) - 1
    # The axes are named last to first.
    return ((points - origin) / spacing / last * 2 - 1).flip(-1)
