"""The Laplace approximation: the posterior as a Gaussian about the estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.fit.model.pose import State


@dataclass(frozen=True, eq=False)
class Posterior:
    """A Gaussian over the increments of `State.moved` at the estimate.

    Args:
        state: The estimate.
        covariance: (P+6,P+6) float64: shape parameters, rotation vector in the shape's frame [rad], translation [mm].
            The unknown mean intensities are integrated out.
    """

    state: State
    covariance: Tensor

    @property
    def deviations(self) -> Tensor:
        """(P+6,) marginal standard deviations."""
        return self.covariance.diagonal().clamp_min(0).sqrt()

    def intervals(self, level: float = 0.9) -> Tensor:
        """(P+6,2) central intervals: shape parameters, then the pose's increments about 0."""
        centre = torch.zeros_like(self.deviations)
        centre[: self.state.theta.numel()] = self.state.theta
        half = math.sqrt(2) * float(torch.special.erfinv(torch.tensor(level, dtype=torch.float64))) * self.deviations
        return torch.stack([centre - half, centre + half], 1)

    def standardised(self, truth: State) -> Tensor:
        """(P+6,) errors of the estimate against a known truth, in marginal standard deviations."""
        return truth.since(self.state) / -self.deviations

    def surface_deviation(self, vertices: Tensor, jacobian: Tensor, normals: Tensor) -> Tensor:
        """(V,) standard deviation [mm] of the surface along its normal at each vertex.

        Args:
            vertices: (V,3) in the shape's own frame.
            jacobian: (V,3,P) derivatives by the shape parameters.
            normals: (V,3) unit normals.
        """
        # A point that moves outward makes the distance there fall: the same chain, with the other sign.
        rows = -self.state.chain(vertices, -torch.einsum("vcp,vc->vp", jacobian, normals), normals)
        return torch.einsum("vi,ij,vj->v", rows, self.covariance, rows).clamp_min(0).sqrt()
