"""Decoders from a code and a point to a signed distance: the published network and one with local codes."""

from __future__ import annotations

import itertools
import math
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.functional import dropout, grid_sample, linear, relu, silu
from torch.nn.utils.parametrizations import weight_norm

from sdm.core.device import plain_defaults
from sdm.core.random import derive_seed
from sdm.deepsdf.train.settings import Settings
from sdm.training.random_numbers import own_random_numbers

# Which layer of the published network sees code and point again.
SKIP = 4
# Radius of the sphere that the local network starts from.
START_RADIUS = 0.5


class PublishedDecoder(nn.Module):
    """J. Park et al., CVPR 2019: fully connected layers with ReLU, weight norm and dropout, tanh at the end.

    The input (code, point) enters the first layer and, joined to that layer's input, the fifth. As a layer's weights
    on the code are the same for all points of a shape, that part is computed once a shape: the values are those of
    the published network, and its weights are kept in its own order.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        width, entry = settings.width, settings.global_size + 3
        self.code_size = self.global_size = settings.global_size
        self.grids: tuple[tuple[int, int], ...] = ()
        self.firsts: list[int] = []
        self.dropout = settings.dropout
        inputs = [entry] + [width] * (settings.layers - 1)
        outputs = [width - entry if layer == SKIP - 1 else width for layer in range(settings.layers)]
        self.hidden = nn.ModuleList(weight_norm(nn.Linear(i, o)) for i, o in zip(inputs, outputs, strict=True))
        self.last = nn.Linear(width, 1)

    def forward(self, codes: Tensor, points: Tensor) -> Tensor:
        """Signed distances (B,N) for codes (B,D) and points (B,N,3) of the unit sphere's box."""
        return self.decode(self.seen(codes, points), points)

    def seen(self, codes: Tensor, points: Tensor) -> tuple[Tensor, ...]:
        """Parts of codes (B,D) that a point sees: all of them, (B,1,D), alike at every point; linear in them."""
        return (codes[:, None],)

    def rows(self, by_seen: tuple[Tensor, ...], points: Tensor) -> Tensor:
        """Derivatives (N,D) by a code of those (N,E) by what points (N,3) see of it."""
        return by_seen[0]

    def corners(self, points: Tensor) -> list[tuple[Tensor, Tensor]]:
        """There are no grids."""
        return []

    def decode(self, seen: tuple[Tensor, ...], points: Tensor) -> Tensor:
        """Signed distances (B,N) for what points (B,N,3) see of codes, each part (B,1,E) or (B,N,E)."""
        x, codes = points, seen[0]
        for number, layer in enumerate(self.hidden):
            weight, bias = cast("tuple[Tensor, Tensor]", (layer.weight, layer.bias))
            if number in (0, SKIP):
                own = weight.shape[1] - self.code_size - 3
                of_code = linear(codes, weight[:, own:-3], bias)
                y = linear(points, weight[:, -3:]) + of_code
                x = y + linear(x, weight[:, :own]) if own else y
            else:
                x = linear(x, weight, bias)
            x = dropout(relu(x), self.dropout, self.training)
        return torch.tanh(self.last(x).float())[..., 0]


class LocalDecoder(nn.Module):
    """A small network on an encoded point, the shape's code, and codes interpolated from coarse grids of the box.

    Local codes are those of R. Chabra et al., "Deep Local Shapes", ECCV 2020, and C. Jiang et al., "Local implicit
    grid representations for 3D scenes", CVPR 2020; here they add to a code of the whole shape, which says what is
    where nothing was seen. The network adds to the distance from a sphere, so that it is a distance from the start.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        width = settings.width
        self.code_size = settings.code_size
        self.global_size = settings.global_size
        self.grids = settings.grids
        # Where each grid begins in a code.
        sizes = [self.global_size, *(channels * resolution**3 for resolution, channels in self.grids)]
        self.firsts = list(itertools.accumulate(sizes))[:-1]
        self.frequencies = settings.frequencies
        self.of_point = nn.Linear(3 + 6 * settings.frequencies, width)
        self.of_code = nn.Linear(settings.global_size, width, bias=False)
        self.of_grids = nn.Linear(max(1, sum(c for _, c in settings.grids)), width, bias=False)
        # Files have this layer in any case. Where nothing goes through it, ranks must not wait for its gradient.
        self.of_grids.requires_grad_(bool(settings.grids))
        self.hidden = nn.ModuleList(nn.Linear(width, width) for _ in range(settings.layers - 1))
        self.last = nn.Linear(width, 1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, codes: Tensor, points: Tensor) -> Tensor:
        """Signed distances (B,N) for codes (B,D) and points (B,N,3) of the unit sphere's box."""
        return self.decode(self.seen(codes, points), points)

    def seen(self, codes: Tensor, points: Tensor) -> tuple[Tensor, ...]:
        """Parts of codes (B,D) that points (B,N,3) see: that of the whole shape, (B,1,G), and of the grids, (B,N,C).

        Linear in the codes: derivatives by any number of these follow from those by what a point sees.
        """
        whole = codes[:, None, : self.global_size]
        return (whole, self._local(codes, points)) if self.grids else (whole,)

    def rows(self, by_seen: tuple[Tensor, ...], points: Tensor) -> Tensor:
        """Derivatives (N,D) by a code of those (N,E) by what points (N,3) of the box see of it."""
        found = points.new_zeros(len(points), self.code_size)
        found[:, : self.global_size] = by_seen[0]
        column = 0
        for first, (resolution, channels), (nodes, weights) in zip(
            self.firsts, self.grids, self.corners(points), strict=True
        ):
            volume = found[:, first : first + channels * resolution**3].view(len(points), channels, resolution**3)
            by = by_seen[1][:, column : column + channels]
            volume.scatter_add_(2, nodes[:, None].expand(-1, channels, -1), by[:, :, None] * weights[:, None])
            column += channels
        return found

    def corners(self, points: Tensor) -> list[tuple[Tensor, Tensor]]:
        """For each grid, numbers (N,8) of the nodes about points (N,3) of the box, and what each of them weighs."""
        found = []
        for resolution, _ in self.grids:
            place = (points + 1) * ((resolution - 1) / 2)
            node = place.floor().clamp(0, resolution - 2)
            share = place - node
            up = torch.tensor(list(itertools.product((0, 1), repeat=3)), device=points.device)
            weights = torch.where(up == 1, share[:, None], 1 - share[:, None]).prod(2)
            x, y, z = (node[:, None] + up).long().unbind(2)
            found.append(((z * resolution + y) * resolution + x, weights))
        return found

    def decode(self, seen: tuple[Tensor, ...], points: Tensor) -> Tensor:
        """Signed distances (B,N) for what points (B,N,3) see of codes, each part (B,1,E) or (B,N,E)."""
        x = self.of_point(self._encoded(points)) + self.of_code(seen[0])
        if self.grids:
            x = x + self.of_grids(seen[1])
        for layer in self.hidden:
            x = layer(silu(x))
        away = points.square().sum(-1).add(1e-12).sqrt() - START_RADIUS
        return away + self.last(silu(x)).float()[..., 0]

    def _encoded(self, points: Tensor) -> Tensor:
        if not self.frequencies:
            return points
        octaves = math.pi * 2.0 ** torch.arange(self.frequencies, device=points.device, dtype=points.dtype)
        angles = (points[..., None] * octaves).flatten(-2)
        return torch.cat([points, angles.sin(), angles.cos()], -1)

    def _local(self, codes: Tensor, points: Tensor) -> Tensor:
        """Codes (B,N,C) at the points, linear between the nodes; beyond the box those of its face."""
        parts = []
        where = points[:, None, None]
        for start, (resolution, channels) in zip(self.firsts, self.grids, strict=True):
            volume = codes[:, start : start + channels * resolution**3]
            volume = volume.reshape(-1, channels, resolution, resolution, resolution)
            parts.append(grid_sample(volume, where, align_corners=True, padding_mode="border")[:, :, 0, 0])
        return torch.cat(parts, 1).transpose(1, 2)


Decoder = PublishedDecoder | LocalDecoder


def make_decoder(settings: Settings) -> Decoder:
    """The network of these settings, with weights that are a function of the seed."""
    with own_random_numbers(), plain_defaults():
        torch.manual_seed(derive_seed(settings.seed, "DeepSDF weights"))
        return PublishedDecoder(settings) if settings.variant == "published" else LocalDecoder(settings)
