"""DeepSDF's own recipe for ground truth, to compare exact samples with.

The nearest of many points of the surface gives the distance, the normals of the eleven nearest vote on the sign, and
samples whose vote is not unanimous are thrown away: J. Park et al., CVPR 2019, section 5 and its published
preprocessing. There the points are those that virtual cameras see, which takes a display; here they are drawn from the
whole surface, which can only be better.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from sdm.mesh import TriangleMesh
from sdm.sampling import SampleDistribution, Samples, ShapeSet, surface_points
from sdm.shapes.sampling import uniform

DENSE, VOTES = 250_000, 11


@dataclass(frozen=True)
class Quality:
    """How far the recipe is from the exact values, near the surface (|d| < 0.1): in unit-sphere radii and shares."""

    mean_error: float
    worst_error: float
    wrong_signs: float
    thrown_away: float
    seconds_a_shape: float


class ApproximateSamples:
    """A fixed table of samples for each shape, from which every step draws; made once, on the CPU.

    Args:
        shapes: The shapes, which also give the exact values that `quality` compares with.
        samples: Of each shape, before some are thrown away; 500,000 as published.
        dense: Points of the surface.
    """

    def __init__(self, shapes: ShapeSet, samples: int = 500_000, dense: int = DENSE) -> None:
        start = time.perf_counter()
        points, values, kept, errors = [], [], [], []
        for number in range(len(shapes)):
            at = shapes.sample(torch.tensor([number], device=shapes.device), samples, seed=1).points[0].cpu()
            found, sure = approximate(shapes.mesh(number).to("cpu"), at, shapes.distribution, dense)
            exact = shapes.signed_distance(torch.tensor([number], device=shapes.device), at[None])[0].cpu()
            near = sure & (exact.abs() < 0.1)
            errors.append(torch.stack([found[near], exact[near]]))
            kept.append(float(sure.float().mean()))
            # Tables of one length: what was thrown away is made up by repeating.
            some = sure.nonzero()[:, 0]
            rows = some[torch.arange(samples) % len(some)]
            points.append(at[rows])
            values.append(found[rows])
        self._points = torch.stack(points).to(shapes.device)
        self._values = torch.stack(values).to(shapes.device)
        both = torch.cat(errors, 1)
        off = (both[0] - both[1]).abs()
        self.quality = Quality(
            mean_error=float(off.mean()),
            worst_error=float(off.max()),
            wrong_signs=float(((both[0] < 0) != (both[1] < 0)).float().mean()),
            thrown_away=1 - float(np.mean(kept)),
            seconds_a_shape=(time.perf_counter() - start) / len(shapes),
        )

    def __len__(self) -> int:
        return len(self._points)

    def sample(self, shapes: Tensor, points: int, *, seed: int = 0, step: int = 0) -> Samples:
        """Rows of the tables, drawn anew in each step."""
        number = (step * len(self) + shapes)[:, None] * points + torch.arange(points, device=shapes.device)
        row = (uniform(seed, number.reshape(-1), 1)[:, 0] * self._values.shape[1]).long().reshape(len(shapes), points)
        return Samples(self._points[shapes[:, None], row], self._values[shapes[:, None], row])


def approximate(
    mesh: TriangleMesh, points: Tensor, distribution: SampleDistribution, dense: int = DENSE
) -> tuple[Tensor, Tensor]:
    """Signed distances (N,) of points (N,3) by the recipe, and which of them are kept (N,)."""
    surface, normals = (part.double().numpy() for part in surface_points(mesh, dense, seed=2))
    at = points.double().numpy()
    _, nearest = KDTree(surface).query(at, VOTES, workers=-1)
    rays = at[:, None] - surface[nearest]
    heights = (rays * normals[nearest]).sum(2)
    distance = np.linalg.norm(rays[:, 0], axis=1)
    # Near the surface, the distance from the plane of the nearest point.
    deviation = np.sqrt(np.resize(distribution.variances, len(at)))
    distance = np.where(distance < deviation, np.abs(heights[:, 0]), distance)
    outside = (heights > 0).sum(1)
    sign = np.where(outside > VOTES // 2, 1.0, -1.0)
    return torch.from_numpy(sign * distance).float(), torch.from_numpy((outside == 0) | (outside == VOTES))
