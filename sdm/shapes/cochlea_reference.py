"""The cochlea's vertices in plain torch: the readable twin of the Warp kernel, in any floating type."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def reference_vertices(theta: Tensor, tables: list[Tensor]) -> Tensor:
    """Vertices (B,V,3) for theta (B,4) and the tables of `sdm.kernels.shapes.cochlea`, in theta's type."""
    stations, station, section, constants = (t.to(theta.dtype) if t.is_floating_point() else t for t in tables)
    rise, phase, fading, inner, share, power = constants
    t, hook, width, top, bottom, slope, cosine, sine = stations.T
    a, alpha, b, phi = theta.T[..., None]

    spiral = a * torch.exp(-b * t)
    r = spiral * hook
    wave = alpha * torch.cos(t - phi - phase)

    def height_of_wave(turns: int) -> Tensor:
        s = spiral * torch.exp(-2 * math.pi * b * turns)
        return wave * s / torch.sqrt(s * s + fading**2)

    outer, own, inmost = (height_of_wave(turns) for turns in (-1, 0, 1))
    z = own + rise * t
    above = inmost - own + 2 * math.pi * rise
    below = own - outer + 2 * math.pi * rise
    size = spiral**power
    width = _soft_min(width * size, inner * r)
    top = _soft_min(_soft_min(top * size, share * above), width)
    bottom = _soft_min(_soft_min(bottom * size, share * below), width)

    at = station.long()
    u = width[:, at] * section[:, 0]
    v = torch.where(section[:, 1] < 0, bottom[:, at], top[:, at]) * section[:, 1]
    rho = r[:, at] + u
    return torch.stack([rho * cosine[at], rho * sine[at], z[:, at] + v + slope[at] * u], -1)


def _soft_min(x: Tensor, y: Tensor) -> Tensor:
    # Not x (1 + (x/y)^12)^(-1/12): sums with a constant are slow under forward-mode differentiation.
    return x * y * (x**12 + y**12) ** (-1 / 12)
