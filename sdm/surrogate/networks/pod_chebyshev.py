"""Proper orthogonal decomposition of maps, and the surrogate without a network that an honest study needs."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn

from sdm.errors import SDMError
from sdm.surrogate.networks.cochlea_grid import GRID
from sdm.surrogate.networks.theta_features import ThetaFeatures, chebyshev
from sdm.training.training_settings import check_counts

# Samples whose voxels are multiplied at a time.
CHUNK = 256


def decompose(maps: Tensor, modes: int) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, modes and singular values of maps, by the method of snapshots (Sirovich 1987).

    Args:
        maps: (N,P) of any floating type.
        modes: How many, at most N - 1.

    Returns:
        mean (P,), orthonormal modes (modes,P), and standard deviations (modes,) of the maps' coefficients; float32.

    Raises:
        SDMError: More modes than the maps can have.
    """
    count = maps.shape[0]
    if not 0 < modes < count:
        raise SDMError(f"{modes} modes of {count} maps were requested; give 1 to {count - 1}, or more maps")
    mean = torch.zeros(maps.shape[1], dtype=torch.float64, device=maps.device)
    for part in maps.split(CHUNK):
        mean += part.double().sum(0)
    mean = (mean / count).float()
    gram = torch.cat([(part.float() - mean) @ (_centred(maps, mean)).T for part in maps.split(CHUNK)])
    energy, vectors = torch.linalg.eigh(gram.double())
    energy, vectors = energy.flip(0)[:modes].clamp_min(0), vectors.flip(1)[:, :modes].float()
    basis = vectors.T @ _centred(maps, mean)
    # Twice, since the modes of small energy lose their right angles to rounding.
    basis = torch.linalg.qr(torch.linalg.qr(basis.T).Q).Q.T
    return mean, basis.contiguous(), (energy / count).sqrt().float()


def _centred(maps: Tensor, mean: Tensor) -> Tensor:
    return maps.float() - mean


class PODChebyshev(nn.Module):
    """Parameters (B,4) to maps (B,1,80,64,40) [mm], negative inside, by modes and polynomials alone.

    Args:
        modes: Modes of the maps on the full grid.
        degree: Total degree of the tensor-Chebyshev polynomials of theta that give the modes' coefficients.

    `fit` finds both from maps; there is no training. A map is one matrix product with (modes, voxels) numbers.
    """

    powers: Tensor
    weights: Tensor
    mean: Tensor
    modes: Tensor

    def __init__(self, modes: int = 256, degree: int = 8) -> None:
        super().__init__()
        check_counts(modes=modes)
        check_counts(0, degree=degree)
        self.config = {"modes": modes, "degree": degree}
        self.features = ThetaFeatures()
        self.register_buffer("powers", total_degree(4, degree), persistent=False)
        self.register_buffer("weights", torch.zeros(len(self.powers), modes))
        self.register_buffer("mean", torch.zeros(GRID.size))
        self.register_buffer("modes", torch.zeros(modes, GRID.size))

    def terms(self, theta: Tensor) -> Tensor:
        """Products of Chebyshev polynomials (B,T) of theta (B,4)."""
        table = torch.stack(chebyshev(self.features.unit(theta), self.config["degree"]), 2)
        picked = [table[:, axis, self.powers[:, axis]] for axis in range(4)]
        return picked[0] * picked[1] * picked[2] * picked[3]

    def forward(self, theta: Tensor) -> Tensor:
        """Maps (B,1,80,64,40) [mm] of theta (B,4)."""
        return torch.addmm(self.mean, self.terms(theta) @ self.weights, self.modes).reshape(-1, 1, *GRID.shape)

    @torch.no_grad()
    def fit(self, theta: Tensor, maps: Tensor, ridge: float = 1e-7) -> PODChebyshev:
        """Modes of maps (N,1,80,64,40) and least-squares polynomials for their coefficients, theta (N,4).

        Args:
            theta: Parameters of the maps; more than there are polynomials.
            maps: Exact maps [mm], of any floating type.
            ridge: Share of the mean square of the polynomials that is added to the normal equations' diagonal.
        """
        flat = maps.reshape(maps.shape[0], -1)
        self.mean, self.modes, _ = decompose(flat, self.config["modes"])
        values = torch.cat([(part.float() - self.mean) @ self.modes.T for part in flat.split(CHUNK)]).double()
        terms = self.terms(theta).double()
        normal = terms.T @ terms
        normal.diagonal().add_(ridge * normal.diagonal().mean())
        self.weights = torch.linalg.solve(normal, terms.T @ values).float()
        return self


def total_degree(variables: int, degree: int) -> Tensor:
    """Powers (T,variables) of all monomials of at most this total degree: T = (variables + degree over degree)."""
    every = itertools.product(range(degree + 1), repeat=variables)
    return torch.tensor([powers for powers in every if sum(powers) <= degree])
