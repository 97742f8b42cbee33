"""Losses of surrogates: weighted to the surface, eikonal, and of the derivatives by the parameters."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from sdm.engine.many import signed_distance_maps
from sdm.shapes import Family
from sdm.surrogate.networks.cochlea_grid import GRID, SPACING_MM

# Half-width [mm] of the shell around the surface that counts more, and how far the eikonal term reaches.
SHELL_MM, EIKONAL_MM = 0.4, 1.0
# Half-width [mm] of the tent within which errors count as voxels on the wrong side.
TENT_MM = 0.2
# Width [mm] of the step by which voxels on the wrong side are counted.
STEP_MM = 0.003
# How far from 1 the exact map's own slope may be where the predicted one is asked to be 1: not at its ridges.
RIDGE = 0.05


def surface_weighted(predicted: Tensor, exact: Tensor, weight: float) -> Tensor:
    """Mean absolute error [mm] of maps (B,1,nx,ny,nz), and `weight` times that of the shell around the surface.

    The shell's error is the mean of each shape first: a small shape's few voxels count as much as a large one's many.
    """
    error = (predicted - exact).abs().flatten(1)
    shell = torch.exp(-((exact / SHELL_MM) ** 2)).flatten(1)
    return error.mean() + weight * ((shell * error).sum(1) / shell.sum(1).clamp_min(1)).mean()


def dice_lost(predicted: Tensor, exact: Tensor) -> Tensor:
    """About 1 - Dice (B,) of the insides of maps (B,1,nx,ny,nz), with gradients.

    The volume between the two surfaces is the integral of the error over the surface, and that is the sum of all
    voxels' errors, weighted by a tent of height 1 / width over the exact distance.
    """
    tent = (1 - exact.abs() / TENT_MM).clamp_min(0) / TENT_MM
    between = ((predicted - exact).abs() * tent).flatten(1).sum(1)
    return between / (2 * (exact < 0).flatten(1).sum(1).clamp_min(1))


def flips(predicted: Tensor, exact: Tensor) -> Tensor:
    """1 - Dice (B,) of the insides of maps (B,1,nx,ny,nz), with gradients: a sigmoid in place of each voxel's step.

    Other than `dice_lost` it sees single voxels, and those on the surface, whose exact distance is zero: they are
    outside, and an error as small as rounding may put them inside. The flat base of the cochleae lies on a plane of
    voxels.
    """
    wrong = torch.sigmoid(torch.where(exact < 0, predicted, -predicted) / STEP_MM)
    return wrong.flatten(1).sum(1) / (2 * (exact < 0).flatten(1).sum(1).clamp_min(1))


def slopes(maps: Tensor) -> Tensor:
    """Length (B,1,nx-2,ny-2,nz-2) of the gradient of maps (B,1,nx,ny,nz), by central differences."""
    inner = slice(1, -1)
    x = maps[..., 2:, inner, inner] - maps[..., :-2, inner, inner]
    y = maps[..., inner, 2:, inner] - maps[..., inner, :-2, inner]
    z = maps[..., inner, inner, 2:] - maps[..., inner, inner, :-2]
    return torch.sqrt(x * x + y * y + z * z + 1e-12) / (2 * SPACING_MM)


def eikonal(predicted: Tensor, exact: Tensor) -> Tensor:
    """Mean | |grad f| - 1 | of predicted maps, within 1 mm of the surface and off the exact maps' ridges."""
    here = (exact[..., 1:-1, 1:-1, 1:-1].abs() < EIKONAL_MM) & ((slopes(exact) - 1).abs() < RIDGE)
    return ((slopes(predicted) - 1).abs() * here).sum() / here.sum().clamp_min(1)


def sobolev(model: nn.Module, family: Family, theta: Tensor, generator: torch.Generator) -> Tensor:
    """Sobolev loss: an unbiased estimate of the mean squared error of d(map)/d(theta) a voxel [mm^2].

    Args:
        model: Parameters (B,4) to maps (B,1,nx,ny,nz).
        family: The shapes; the exact engine gives their derivative.
        theta: (B,4); derivatives are scaled to the box, as if each parameter ran from 0 to 1.
        generator: Of the random signs, on the host.

    For random signs v, E |v^T (J - J*)|^2 = |J - J*|^2 (Hutchinson 1990), so that one backward pass through the
    exact map and one through the model are enough.
    """
    theta = theta.detach().requires_grad_()
    signs = torch.randint(0, 2, (len(theta), 1, *GRID.shape), generator=generator).to(theta.device) * 2.0 - 1
    exact = signed_distance_maps(family.vertices(theta), family.faces_on(theta.device), GRID, device=theta.device)
    (wanted,) = torch.autograd.grad((exact[:, None] * signs).sum(), theta)
    (found,) = torch.autograd.grad((model(theta) * signs).sum(), theta, create_graph=True)
    widths = torch.tensor([p.high - p.low for p in family.parameters], device=theta.device)
    return (((found - wanted) * widths) ** 2).sum(1).mean() / GRID.size
