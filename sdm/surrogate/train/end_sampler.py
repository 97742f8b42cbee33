"""Sampler of a surrogate's training that is dense towards the ends of the parameters, and never at a corner."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from sdm.shapes import Family
from sdm.stream import Chebyshev
from sdm.stream.held_out import held_out_rows


class Ends(Chebyshev):
    """Of four samples two as "chebyshev" has them, one nearer to the ends, one nearer to the hardest shapes.

    Nearer to the ends: sin^2(pi/2 u) of the unit value u of each parameter, once more than "chebyshev" does it, so that
    a twentieth of the samples has all four parameters within a twentieth of an end. The hardest shapes are small ones,
    whose few voxels inside make a Dice coefficient low: half of the last quarter has the least radius and the quickest
    decay (`a` is folded to its lower end and `b` to its upper one), half of it the least radius and the highest wave,
    where turns crowd each other, whatever the others are. No sample is a corner of the box.
    """

    def theta(self, family: Family, seed: int, index: Tensor) -> Tensor:
        """As `Sampler.theta`."""
        theta = super().theta(family, seed, index)
        low = torch.tensor([p.low for p in family.parameters], dtype=torch.float64, device="cpu")
        width = torch.tensor([p.high for p in family.parameters], dtype=torch.float64, device="cpu") - low
        unit = torch.sin(math.pi / 2 * (theta.double() - low) / width).square()
        names = [p.name for p in family.parameters]
        small, crowded = index % 8 == 3, index % 8 == 7
        for name, end, where in (
            ("a", torch.minimum, small | crowded),
            ("b", torch.maximum, small),
            ("alpha", torch.maximum, crowded),
        ):
            if name in names:
                own = unit[:, names.index(name)]
                own[where] = end(own, 1 - own)[where]
        for k, name in enumerate(names):
            if name not in ("a", "alpha"):
                unit[crowded, k] = ((theta.double() - low) / width)[crowded, k]
        nearer = torch.where((index % 2 == 1)[:, None], (low + unit * width).float(), theta)
        nearer = torch.minimum(torch.maximum(nearer, low.float()), (low + width).float())
        # Validation shapes stay out, and corners, which validation sets have.
        corner = ((nearer == low.float()) | (nearer == (low + width).float())).all(1)
        barred = torch.from_numpy(held_out_rows(nearer.numpy())) | corner
        return torch.where(barred[:, None], theta, nearer)

    def __str__(self) -> str:
        return "ends"
