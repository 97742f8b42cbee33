"""Scans of a shape: points of its surface, or of a part of it, perhaps with normals and noise."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import normalize

from sdm.core.mesh import as_tensor
from sdm.core.random import derive_seed
from sdm.deepsdf.samples import Samples
from sdm.errors import SDMError
from sdm.shapes.sampling import uniform

FEWEST = 100
# How far along the normals a point is set off to either side, in unit-sphere radii.
OFFSET = 0.01


class Scan:
    """Samples of shapes of which only points of the surface are known; a `Draw` for `estimate_codes`.

    Args:
        points: (N,3) of one shape or (B,N,3) of several, in the unit sphere.
        normals: Outward normals of the same shape, of any length; None if nobody knows them.
        count: Points of a step; all if there are not more.
        seed: Which points a step takes is a function of it and of the step.
        offset: As J. Park et al., CVPR 2019, section 6.3: with normals n a point p stands for p + offset n and
            p - offset n, whose distances are offset and -offset. Without normals it stands for itself, at distance 0:
            then what is inside is for the prior to say.

    Raises:
        SDMError: Fewer than 100 points, a point that is not finite, or normals of another shape, not finite or of
            length 0.
    """

    def __init__(
        self, points: Any, normals: Any = None, *, count: int = 8000, seed: int = 0, offset: float = OFFSET
    ) -> None:
        at = as_tensor(points, torch.float32, "the scan's points")
        at = at[None] if at.ndim == 2 else at
        if at.ndim != 3 or at.shape[2] != 3:
            raise SDMError(f"the scan has the shape {tuple(at.shape)}; (N, 3) is needed")
        if at.shape[1] < FEWEST:
            raise SDMError(f"the scan has {at.shape[1]} points; at least {FEWEST} are needed to find a shape")
        if not bool(at.isfinite().all()):
            raise SDMError(f"{int((~at.isfinite().all(-1)).sum())} points of the scan are not finite; leave them out")
        self._points, self._normals = at, None
        if normals is not None:
            out = as_tensor(normals, torch.float32, "the scan's normals", device=at.device)
            out = out[None] if out.ndim == 2 else out
            if out.shape != at.shape:
                raise SDMError(
                    f"the scan has {tuple(at.shape)} points and {tuple(out.shape)} normals; give one for each"
                )
            self._normals = _unit(out)
        self._count = min(count, at.shape[1])
        self._seed, self._offset = derive_seed(seed, "points of a scan"), offset

    def __call__(self, step: int) -> Samples:
        """The samples of a step, (B,N,3) and (B,N)."""
        total, device = self._points.shape[1], self._points.device
        number = torch.arange(step * self._count, (step + 1) * self._count, device=device)
        chosen = (uniform(self._seed, number, 1)[:, 0] * total).long()
        at = self._points[:, chosen]
        if self._normals is None:
            return Samples(at, at.new_zeros(at.shape[:2]))
        off = self._offset * self._normals[:, chosen]
        values = at.new_full(at.shape[:2], self._offset)
        return Samples(torch.cat([at + off, at - off], 1), torch.cat([values, -values], 1))


def _unit(normals: Tensor) -> Tensor:
    """Normals (B,N,3) with length 1."""
    # The squares of lengths that float32 holds are beyond it.
    wide = normals.double()
    wrong = ~(wide.isfinite().all(-1) & (wide.norm(dim=-1) > 0))
    if bool(wrong.any()):
        row = int(wrong.nonzero()[0, -1])
        raise SDMError(
            f"{int(wrong.sum())} normals of the scan are not finite or have no length, the first in row {row} "
            f"({normals[wrong][0].tolist()}); leave those points out, or give no normals"
        )
    return normalize(wide, dim=-1, eps=0.0).float()


def half_of(points: Tensor, direction: Tensor) -> Tensor:
    """Mask (N,) of the points (N,3) that a scan from `direction` (3,) keeps: the half of them that is nearest to it.

    Raises:
        SDMError: They are no such tensors.
    """
    real = isinstance(points, Tensor) and isinstance(direction, Tensor) and points.is_floating_point()
    if not real or points.ndim != 2 or points.shape[1] != 3 or not len(points) or direction.shape != (3,):
        raise SDMError("half a scan needs tensors of numbers: points (N,3) and a direction (3,)")
    along = points @ direction.to(points)
    return along > along.median()
