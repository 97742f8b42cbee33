"""Compactness, generalisation and specificity of shape models, as the field defines them.

R. Davies, "Learning shape: optimal models for analysing natural variability", 2002; M. Styner et al., "Evaluation of 3D
correspondence methods for model building", IPMI 2003.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from sdm.core.random import generator

DRAWN = 200


def compactness(deviations: Tensor) -> Tensor:
    """Share (M,) of the variance that the first 1, 2, ... modes hold."""
    return deviations.square().cumsum(0) / deviations.square().sum()


def generalisation(aligned: Tensor, modes: Sequence[int]) -> dict[str, list[float]]:
    """Leave-one-out error of aligned shapes (N,V,3): mean distance of vertices from their places in the model.

    Args:
        aligned: In correspondence, aligned once.
        modes: Numbers of modes.

    Returns:
        `modes`, and for each the `mean` over shapes and the `worst` shape's error, in the shapes' unit.
    """
    flat = aligned.flatten(1)
    modes = [m for m in modes if m <= len(flat) - 2]
    errors = []
    for out in range(len(flat)):
        others = torch.cat([flat[:out], flat[out + 1 :]])
        mean = others.mean(0)
        basis = torch.linalg.svd(others - mean, full_matrices=False).Vh
        own = basis @ (flat[out] - mean)
        errors.append(
            [float((mean + own[:m] @ basis[:m] - flat[out]).reshape(-1, 3).norm(dim=1).mean()) for m in modes]
        )
    table = torch.tensor(errors, device="cpu").reshape(len(flat), -1)
    return {
        "modes": list(modes),
        "mean": [round(x, 5) for x in table.mean(0).tolist()],
        "worst": [round(x, 5) for x in table.amax(0).tolist()],
    }


def specificity(
    aligned: Tensor, directions: Tensor, deviations: Tensor, modes: Sequence[int], drawn: int = DRAWN
) -> dict[str, list[float]]:
    """Mean distance of vertices of random shapes of the model from the nearest of the shapes (N,V,3) that made it.

    Args:
        aligned: The shapes.
        directions: Modes (M,V,3).
        deviations: (M,).
        modes: Numbers of modes.
        drawn: Random shapes, of normally distributed theta.
    """
    mean = aligned.mean(0)
    theta = torch.randn(
        drawn, len(deviations), generator=generator(0, "specificity"), dtype=torch.float64, device="cpu"
    )
    scaled = theta * deviations
    found = []
    for m in modes:
        shapes = mean + torch.einsum("nm,mvc->nvc", scaled[:, :m], directions[:m])
        nearest = [float((aligned - one).norm(dim=2).mean(1).min()) for one in shapes]
        found.append(round(sum(nearest) / drawn, 5))
    return {"modes": list(modes), "mean": found}
