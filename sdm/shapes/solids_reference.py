"""Vertices of solids in plain torch: the readable twin of the Warp kernel, in any floating type."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from sdm.kernels.shapes.rotation import SMALLEST
from sdm.kernels.shapes.solids import RHOMBOID


def reference_vertices(theta: Tensor, tables: list[Tensor]) -> Tensor:
    """Vertices (B,V,3) for theta (B,P) and the tables of `sdm.kernels.shapes.solids`, in theta's type."""
    unit, column, fallback = tables
    # Every kind has the same column for the kind itself.
    own = int(column[0, 0])
    kinds = theta[:, own].detach() if own >= 0 else fallback[0].expand(len(theta))
    kind = kinds.floor().long().clamp(0, len(unit) - 1)
    columns = column.long()[kind]
    given = theta.gather(1, columns.clamp_min(0))
    slots = torch.where(columns >= 0, given, fallback.to(theta.dtype))[..., None].unbind(1)
    x, y, z = (size * axis for size, axis in zip(slots[1:4], unit.to(theta.dtype)[kind].unbind(2), strict=True))
    sheared = (kind == RHOMBOID)[:, None]
    xy, xz, yz = (torch.where(sheared, slot, 0.0) for slot in slots[4:7])
    points = torch.stack([x + xy * y + xz * z, y + yz * z, z], 2)
    return _turned(points, *slots[7:10]) + torch.stack(slots[10:], 2)


def _turned(points: Tensor, u1: Tensor, u2: Tensor, u3: Tensor) -> Tensor:
    """Points (B,V,3) by the rotations of Shoemake, Graphics Gems III, 1992, of numbers (B,1) in (0,1)."""
    inner, outer = (1 - u1).clamp_min(SMALLEST).sqrt(), u1.clamp_min(SMALLEST).sqrt()
    second, third = 2 * math.pi * u2, 2 * math.pi * u3
    real = (outer * third.cos())[..., None]
    axis = torch.stack([inner * second.sin(), inner * second.cos(), outer * third.sin()], 2)
    along = (axis * points).sum(2, keepdim=True)
    crossed = torch.linalg.cross(axis.expand_as(points), points)
    return (2 * real * real - 1) * points + 2 * real * crossed + 2 * along * axis
