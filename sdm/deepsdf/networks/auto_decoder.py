"""Auto-decoder: the network and the codes of the training shapes, learned together."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from sdm.core.random import generator
from sdm.deepsdf.networks.decoders import make_decoder
from sdm.deepsdf.train.settings import Settings


class AutoDecoder(nn.Module):
    """One code for each shape, and the decoder that they share.

    Args:
        settings: What it is.
        count: Number of shapes.
    """

    def __init__(self, settings: Settings, count: int) -> None:
        super().__init__()
        self.settings = settings
        self.decoder = make_decoder(settings)
        random = generator(settings.seed, "DeepSDF codes")
        start = torch.randn(count, settings.code_size, generator=random, dtype=torch.float32, device="cpu")
        self.codes = nn.Parameter(settings.code_deviation * start)

    def forward(self, shapes: Tensor, points: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
        """The data's loss and the codes' mean squared length: scalars, for shapes (B,), (B,N,3) and (B,N)."""
        codes = bounded(self.codes[shapes], self.settings.code_bound)
        # A sum over numbers and a mean over shapes: what the codes cost does not depend on the number of points.
        return errors(self.decoder(codes, points), values, self.settings).mean(), codes.square().sum(1).mean()

    @torch.no_grad()
    def bounded_codes(self) -> Tensor:
        """The codes (S,D) as the decoder sees them."""
        return bounded(self.codes, self.settings.code_bound)


def bounded(codes: Tensor, bound: float | None) -> Tensor:
    """Codes (B,D) no longer than `bound`."""
    if bound is None:
        return codes
    return codes * (bound / codes.norm(dim=1, keepdim=True).clamp(min=bound))


def errors(prediction: Tensor, values: Tensor, settings: Settings) -> Tensor:
    """Loss of each sample, of the shape of both.

    The paper's |clamp(p) - clamp(y)|, equation (4), or |p - y| / (1 + |y| / clamp): the second fades with the distance,
    so that far values count a little, and never lets a wrong prediction go without a gradient.
    """
    if settings.variant == "published":
        bound = settings.clamp
        return (prediction.clamp(-bound, bound) - values.clamp(-bound, bound)).abs()
    return (prediction - values).abs() / (1 + values.abs() / settings.clamp)
