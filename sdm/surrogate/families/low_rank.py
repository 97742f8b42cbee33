"""Low-rank surrogate of any family: modes of its maps, and coefficients by polynomials and a small network."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from sdm.surrogate.networks.theta_features import chebyshev

# Degree of the features of each parameter, and the most polynomial terms.
DEGREE, MOST_TERMS = 4, 800
MOST_PARAMETERS = 64


class LowRankSurrogate(nn.Module):
    """Parameters (B,P) to maps (B,1,nx,ny,nz), negative inside: mean + coefficients(theta) @ modes.

    Args:
        low: (P,) ends of the family's box.
        high: (P,).
        shape: (nx,ny,nz) of its grid.
        modes: Modes of the maps (proper orthogonal decomposition).
        degree: Total degree of the Chebyshev polynomials that give the coefficients first.
        hidden: Width of the network that adds what these leave; 0 for none.
    """

    powers: Tensor
    middle: Tensor
    reach: Tensor
    mean: Tensor
    modes: Tensor
    weights: Tensor
    scale: Tensor

    def __init__(
        self,
        low: Sequence[float],
        high: Sequence[float],
        shape: Sequence[int],
        modes: int,
        degree: int,
        hidden: int = 128,
    ) -> None:
        super().__init__()
        self.config = {
            "low": list(low),
            "high": list(high),
            "shape": list(shape),
            "modes": modes,
            "degree": degree,
            "hidden": hidden,
        }
        count, size = len(low), math.prod(shape)
        box = torch.tensor([list(low), list(high)], dtype=torch.float64, device="cpu")
        self.register_buffer("middle", box.mean(0).float(), persistent=False)
        self.register_buffer("reach", ((box[1] - box[0]) / 2).clamp_min(1e-12).float(), persistent=False)
        self.register_buffer("powers", total_degree_terms(count, degree), persistent=False)
        self.register_buffer("weights", torch.zeros(len(self.powers), modes, device="cpu"))
        self.register_buffer("scale", torch.ones(modes, device="cpu"))
        self.register_buffer("mean", torch.zeros(size, device="cpu"))
        self.register_buffer("modes", torch.zeros(modes, size, device="cpu"))
        self.network: nn.Module | None = None
        if hidden:
            self.network = nn.Sequential(
                nn.Linear(count * DEGREE, hidden), nn.SiLU(), nn.Linear(hidden, hidden), nn.SiLU()
            )
            self.network.append(nn.Linear(hidden, modes))  # pyright: ignore[reportAttributeAccessIssue]

    def unit(self, theta: Tensor) -> Tensor:
        """Parameters (B,P) scaled to [-1, 1]."""
        return (theta - self.middle) / self.reach

    def terms(self, theta: Tensor) -> Tensor:
        """Products of Chebyshev polynomials (B,T)."""
        table = torch.stack(chebyshev(self.unit(theta), max(1, self.config["degree"])), 2)
        found = table[:, 0, self.powers[:, 0]]
        for axis in range(1, self.powers.shape[1]):
            found = found * table[:, axis, self.powers[:, axis]]
        return found

    def coefficients(self, theta: Tensor) -> Tensor:
        """Coefficients (B,M) of the modes."""
        found = self.terms(theta) @ self.weights
        return found if self.network is None else found + self.scale * self.rest(theta)

    def rest(self, theta: Tensor) -> Tensor:
        """Output (B,M) of the network, which polynomials leave to it, of order one."""
        assert self.network is not None  # noqa: S101 - for the type checker
        return self.network(torch.cat(chebyshev(self.unit(theta), DEGREE)[1:], 1))

    def forward(self, theta: Tensor) -> Tensor:
        """Maps (B,1,nx,ny,nz) of theta (B,P), float32."""
        shape = self.config["shape"]
        return torch.addmm(self.mean, self.coefficients(theta), self.modes).reshape(-1, 1, *shape)


def count_of_terms(parameters: int, degree: int) -> int:
    """Number of polynomials of at most this total degree."""
    return math.comb(parameters + degree, degree)


def total_degree_terms(parameters: int, degree: int) -> Tensor:
    """Powers (T,P) of all monomials of at most this total degree, without a walk through the whole tensor grid."""
    found: list[tuple[int, ...]] = [()]
    for _ in range(parameters):
        found = [(*powers, k) for powers in found for k in range(degree - sum(powers) + 1)]
    return torch.tensor(found, dtype=torch.int64, device="cpu")
