"""Discretisation error of rendered shares: facets of the mesh and sample points of the voxels, extrapolated to none.

Facets lie inside a round surface, and the logistic of a signed distance blurs a curved surface outwards: each moves the
whole surface by about 0.001 mm. Both errors fall with the square of the edge or the distance between sample points, so
that one rendering at half of both tells how large they are (Richardson 1911).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.core.grid import Grid
from sdm.fit.model.backend import Backend, finer_of
from sdm.fit.model.pose import State
from sdm.fit.solve.fit_shape import FitOptions, renderer_of

# What errors of second order are over, once they have been seen at a step and at half of it; the share of it that is
# taken for the deviation of what is left (of 0.1 to 0.3 in four cochleae against meshes and points finer still).
OVER, UNSURE = 1 / 3, 0.5


@dataclass(frozen=True, eq=False)
class Discretisation:
    """Errors of N voxels' shares of inside at one state.

    Args:
        correction: (N,) to be added to the shares.
        left: (2,N) deviations of what is left, for facets and for sample points.
        reach: Deviation of the point spread function along each axis [voxels].
    """

    correction: Tensor
    left: Tensor
    reach: tuple[float, ...]

    def score(self, rows: Tensor) -> Tensor:
        """(K,K) covariance of `rows @ error` for rows (K,nx,ny,nz).

        What is left is as one factor on all of the surface, as far as it is of second order, and besides as large but
        of either sign from one spot of the size of the point spread function to the next.
        """
        shape, flat = rows.shape[1:], rows.flatten(1)
        whole = flat @ self.left.T
        own = rows * self.left.square().sum(0).sqrt().view(shape)
        near = own
        for axis, reach in enumerate(self.reach, 1):
            at = torch.arange(shape[axis - 1], dtype=rows.dtype, device=rows.device)
            alike = torch.exp(-((at[:, None] - at) ** 2) / (4 * reach**2))
            near = (near.movedim(axis, -1) @ alike).movedim(-1, axis)
        return whole @ whole.T + own.flatten(1) @ near.flatten(1).T


def discretisation(grid: Grid, backend: Backend, options: FitOptions, state: State, share: Tensor) -> Discretisation:
    """Errors of the shares of inside (N,) that a renderer of these options gives at a state.

    Meshes of four times as many triangles are asked where the backend's shapes do not depend on them.
    """
    finer = finer_of(backend)

    def rendered(by: Backend, times: int) -> Tensor:
        return renderer_of(grid, by, options, times)(state, derivatives=False).share.flatten()

    middle = share if finer is None else rendered(finer, 1)
    fine = rendered(finer or backend, 2)
    changes = torch.stack([middle - share, fine - middle])
    reach = tuple(math.sqrt((options.blur / s) ** 2 + 1 / 12) for s in grid.spacing)
    return Discretisation((1 + OVER) * changes.sum(0), UNSURE * OVER * changes, reach)
