"""A DeepSDF whose decoder is a formula: star-shaped blobs, whose codes are the heights of bumps."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from sdm.deepsdf import DeepSDF, local
from sdm.deepsdf.samples import UnitSphere

RADIUS, NUMBERS, SHAPES = 0.6, 12, 20
# Bumps of all shapes alike, without which one would be another one turned.
MEAN = torch.tensor([0.3, -0.2, 0.1, 0.25, -0.15, 0.0] * 2)


class BlobDecoder(nn.Module):
    """Distance from the centre less the radius, which has bumps in twelve directions, one for each number."""

    def __init__(self) -> None:
        super().__init__()
        random = torch.Generator().manual_seed(0)
        towards = torch.randn(NUMBERS, 3, generator=random)
        self.towards = torch.nn.functional.normalize(towards, dim=1)
        self.code_size = self.global_size = NUMBERS
        self.grids, self.firsts = (), []

    def forward(self, codes: Tensor, points: Tensor) -> Tensor:
        return self.decode(self.seen(codes, points), points)

    def seen(self, codes: Tensor, points: Tensor) -> tuple[Tensor, ...]:
        return (codes[:, None],)

    def rows(self, by_seen: tuple[Tensor, ...], points: Tensor) -> Tensor:
        return by_seen[0]

    def corners(self, points: Tensor) -> list[tuple[Tensor, Tensor]]:
        return []

    def decode(self, seen: tuple[Tensor, ...], points: Tensor) -> Tensor:
        far = points.square().sum(-1).add(1e-6).sqrt()
        bumps = (2 * (points @ self.towards.T / far[..., None] - 1)).exp()
        return far - RADIUS - (bumps * seen[0]).sum(-1)


def blobs() -> DeepSDF:
    """Shapes of about 10 units whose first three numbers vary much, the others a little."""
    spread = torch.tensor([0.12] * 3 + [0.06] * (NUMBERS - 3))
    codes = MEAN + spread * torch.randn(SHAPES, NUMBERS, generator=torch.Generator().manual_seed(1))
    spheres = [UnitSphere((0.0, 0.0, 0.0), 5.0 + 0.05 * (k % 5)) for k in range(SHAPES)]
    settings = local(global_size=NUMBERS, grids=(), code_deviation=0.05)
    return DeepSDF(settings, BlobDecoder(), codes, [str(k) for k in range(SHAPES)], spheres)  # type: ignore[arg-type]
