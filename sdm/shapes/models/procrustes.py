"""Generalised Procrustes alignment: shapes in correspondence laid onto their mean (Gower 1975)."""

from __future__ import annotations

import torch
from torch import Tensor

MOST_TURNS, STILL = 100, 1e-9


def procrustes(shapes: Tensor, *, scale: bool = False) -> tuple[Tensor, Tensor]:
    """Shapes moved and turned, and scaled if asked, so as to lie on their mean.

    Args:
        shapes: (N,V,3) in correspondence, any floating type.
        scale: Take sizes out too. The mean then has the shapes' mean size.

    Returns:
        Aligned shapes (N,V,3) and their mean (V,3), float64. The first shape's axes are kept.
    """
    points = shapes.double()
    points = points - points.mean(1, keepdim=True)
    sizes = points.flatten(1).norm(dim=1)
    size = sizes.mean()
    if scale:
        points = points * (size / sizes)[:, None, None]
    mean = points[0]
    for _ in range(MOST_TURNS):
        points = points @ rotations(points, mean)
        if scale:
            # The least-squares factor, so that an odd shape does not have the size of its own alone.
            along = (points * mean).sum((1, 2)) / points.square().sum((1, 2))
            points = points * along[:, None, None]
        fresh = points.mean(0)
        # The mean may turn and shrink as it is found.
        fresh = fresh @ rotations(fresh[None], points[0])[0]
        if scale:
            fresh = fresh * (size / fresh.norm())
        moved = float((fresh - mean).norm() / mean.norm())
        mean = fresh
        if moved < STILL:
            break
    turned = points @ rotations(points, mean)
    return turned, turned.mean(0)


def rotations(points: Tensor, onto: Tensor) -> Tensor:
    """Rotations (N,3,3), to be applied from the right, that lay points (N,V,3) onto (V,3) about the origin; no mirror.

    By the singular value decomposition of the covariance (Kabsch 1976).
    """
    u, _, vt = torch.linalg.svd(points.transpose(1, 2) @ onto)
    sign = torch.det(u @ vt).sign()
    fixed = u.clone()
    fixed[:, :, 2] *= sign[:, None]
    return fixed @ vt
