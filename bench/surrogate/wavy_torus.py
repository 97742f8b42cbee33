"""A user's family of three parameters, to train surrogates of: `--family bench/surrogate/wavy_torus.py:WavyTorus`."""

from __future__ import annotations

import math

import torch

from sdm.shapes import Family, Parameter


class WavyTorus(Family):
    """Tori about z whose ring goes up and down twice: radius of the ring, of the tube, height of the wave."""

    name = "wavy-torus"
    parameters = (Parameter("R", 2.0, 3.0, "mm"), Parameter("r", 0.5, 0.9, "mm"), Parameter("wave", 0.0, 0.5, "mm"))

    def __init__(self, around: int = 96, across: int = 32) -> None:
        i, j = torch.meshgrid(torch.arange(around, device="cpu"), torch.arange(across, device="cpu"), indexing="ij")
        self.u, self.v = 2 * math.pi / around * i.reshape(-1), 2 * math.pi / across * j.reshape(-1)
        right, up = (i + 1) % around, (j + 1) % across
        a, b, c, d = (p.reshape(-1) for p in (i * across + j, right * across + j, right * across + up, i * across + up))
        self.triangles = torch.cat([torch.stack([a, b, c], 1), torch.stack([a, c, d], 1)]).int()

    def vertices(self, theta: torch.Tensor) -> torch.Tensor:
        """Vertices (B,V,3) for theta (B,3)."""
        ring, tube, wave = theta.unbind(1)
        u, v = self.u.to(theta), self.v.to(theta)
        out = ring[:, None] + tube[:, None] * torch.cos(v)
        height = tube[:, None] * torch.sin(v) + wave[:, None] * torch.cos(2 * u)
        return torch.stack([out * torch.cos(u), out * torch.sin(u), height], 2)
