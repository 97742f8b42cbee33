"""The further measures of the DeepSDF paper: earth mover's distance, mesh accuracy, mesh completion, cosine of normals.

J. Park et al., CVPR 2019, section 6 and its supplement. All lengths are in the paper's scale, where the true surface's
bounding box has a diagonal of 1 (`sdm.deepsdf.infer.scores` says why).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from sdm.core.mesh import TriangleMesh, as_tensor
from sdm.core.random import derive_seed
from sdm.deepsdf.samples import surface_points
from sdm.engine.api import MeshIndex
from sdm.errors import SDMError

# Points of each surface for the earth mover's distance, and of one surface for the other measures.
EMD_POINTS, POINTS = 500, 1000
# Share of the points that mesh accuracy speaks of, and the distance that counts as complete.
ACCURACY_SHARE, COMPLETE_WITHIN = 0.9, 0.01


@dataclass(frozen=True, kw_only=True)
class PaperMeasures:
    """Measures of one shape, in the paper's scale.

    Args:
        emd: Mean distance of the best one-to-one pairing of 500 random points of each surface. Two draws from the very
            same surface do not score 0 but `emd_floor`.
        emd_floor: The same between two draws from the true surface.
        accuracy: 90 % of the points of the found surface are within this of the true one.
        completion: Share of the true surface's points that are within 0.01 of the found one.
        normal_cosine: Mean cosine between the normal at a true point and that of the found surface's nearest face.
    """

    emd: float
    emd_floor: float
    accuracy: float
    completion: float
    normal_cosine: float


def point_set(points: Any) -> np.ndarray:
    """Points (N,3) float64 on the host.

    Raises:
        MeshError: They are no numbers.
        SDMError: They are none, or not (N,3).
    """
    at = as_tensor(points, torch.float64, "the points", device=torch.device("cpu"))
    if at.ndim != 2 or at.shape[1] != 3 or not len(at):
        raise SDMError(f"points of shape {tuple(at.shape)} have no distance from others: give (N,3)")
    return at.detach().numpy()


def earth_movers_distance(a: Tensor, b: Tensor) -> float:
    """Mean distance of the one-to-one pairing of points a (N,3) and b (N,3) that makes it smallest."""
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    apart = cdist(point_set(a), point_set(b))
    return float(apart[linear_sum_assignment(apart)].mean())


def paper_measures(found: MeshIndex, truth: MeshIndex, diagonal: float, *, seed: int = 0) -> PaperMeasures:
    """Measures of a found surface against the true one.

    Args:
        found: The found surface.
        truth: The true one, in the same unit and on the same device.
        diagonal: Of the true surface's bounding box, in that unit.
        seed: Of the random points.
    """
    own, _ = _points(found.mesh, seed, 0)
    right, normals = _points(truth.mesh, seed, 1)
    again, _ = _points(truth.mesh, seed, 2)
    away = truth.signed_distance(own).abs()
    back, hit = found.signed_distance(right, return_closest=True)
    faces = _normals(found.mesh)[hit.faces.long()]
    few = slice(EMD_POINTS)
    return PaperMeasures(
        emd=earth_movers_distance(own[few], right[few]) / diagonal,
        emd_floor=earth_movers_distance(right[few], again[few]) / diagonal,
        accuracy=float(away.double().quantile(ACCURACY_SHARE)) / diagonal,
        completion=float((back.abs() <= COMPLETE_WITHIN * diagonal).double().mean()),
        normal_cosine=float((faces * normals.double()).sum(1).mean()),
    )


def _points(mesh: TriangleMesh, seed: int, number: int) -> tuple[Tensor, Tensor]:
    return surface_points(mesh, POINTS, seed=derive_seed(seed, "points of the paper's measures", number))


def _normals(mesh: TriangleMesh) -> Tensor:
    """Unit normals (F,3) float64; 0 of a face without an area."""
    a, b, c = mesh.vertices.detach()[mesh.faces.long()].double().unbind(1)
    return torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=1e-300)
