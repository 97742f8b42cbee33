"""Codes of shapes that were never trained on: maximum a posteriori estimation, a batch at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from sdm.deepsdf.infer.scan import Scan
from sdm.deepsdf.networks.auto_decoder import bounded, errors
from sdm.deepsdf.networks.code_prior import CodePrior
from sdm.deepsdf.networks.model import DeepSDF
from sdm.deepsdf.samples import Samples
from sdm.errors import SDMError
from sdm.training.schedules import cosine_decay

# A step's samples (B,N,3) and (B,N) for a batch of shapes.
Draw = Callable[[int], Samples]
# Weights of the prior: the paper's, and those of the "local" variant for scans and for exact samples all around.
PUBLISHED, OF_SCANS, OF_SHAPES = 1e-4, 1e-6, 1e-9


@dataclass(frozen=True)
class Estimate:
    """Codes that were found, and their losses.

    Args:
        codes: (B,D).
        losses: (B,) mean cost of the samples of each shape at the last step, in unit-sphere radii.
    """

    codes: Tensor
    losses: Tensor


def check_steps(steps: int) -> None:
    """Refuse a search that takes no steps.

    Raises:
        SDMError: It is one.
    """
    if steps < 1:
        raise SDMError(f"{steps} steps were requested; give 1 or more, 800 as published")


def estimate_codes(
    model: DeepSDF,
    draw: Draw,
    *,
    steps: int = 800,
    rate: float | None = None,
    prior: float | None = None,
    compile_network: bool = False,
) -> Estimate:
    """The codes under which samples are most probable: J. Park et al., CVPR 2019, equation (10), by Adam.

    Args:
        model: The decoder, which stays what it is.
        draw: Called with the step's number; gives that step's samples of all shapes.
        steps: Of Adam; the rate is a tenth from the middle on for the "published" variant, as in the original, and
            falls along a cosine for the "local" one.
        rate: Adam's learning rate; 5e-3 as published, or 2e-2 for the "local" variant.
        prior: Weight of `CodePrior`. By default 1e-4 for the "published" variant; for the "local" one 1e-6 if `draw` is
            a `Scan`, which leaves much open, else 1e-9.
        compile_network: By torch.compile, which pays for many steps on a GPU.

    Returns:
        A code for each shape of the batch. Shapes do not influence each other.

    Raises:
        SDMError: No steps.
    """
    check_steps(steps)
    settings = model.settings
    published = settings.variant == "published"
    rate = (5e-3 if published else 2e-2) if rate is None else rate
    if prior is None:
        prior = PUBLISHED if published else OF_SCANS if isinstance(draw, Scan) else OF_SHAPES
    unlikely = CodePrior(model)
    points, values = draw(0)
    # From the middle of what was learned, whatever the order of the shapes.
    codes = unlikely.start.repeat(points.shape[0], 1).requires_grad_()
    optimizer = torch.optim.Adam([codes], lr=rate)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda s: _rate_at(s / steps, published))

    def costs(codes: Tensor, points: Tensor, values: Tensor) -> Tensor:
        return errors(model.decoder(bounded(codes, settings.code_bound), points), values, settings).mean(1)

    of = torch.compile(costs) if compile_network else costs
    losses = torch.zeros(points.shape[0], device=model.device, dtype=points.dtype)
    with torch.enable_grad():
        for step in range(steps):
            if step:
                points, values = draw(step)
            losses = of(codes, points, values)
            # Sums over shapes: each shape's gradient is what it would be alone.
            (losses.sum() + prior * unlikely(codes).sum()).backward()
            optimizer.step()
            optimizer.zero_grad()
            schedule.step()
    return Estimate(bounded(codes.detach(), settings.code_bound), losses.detach())


def _rate_at(done: float, published: bool) -> float:
    if published:
        return 1.0 if done < 0.5 else 0.1
    return cosine_decay(done, floor=0.01)
