"""Derivatives of many distances by a whole code: a sparse matrix, whose products are small dense ones.

A point sees eight nodes of each of the code's grids. Points that lie in the same cells see the same numbers: they are
put side by side, in runs of up to `RUN`, and a product with the matrix is one with a dense block for each run.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from sdm.deepsdf.networks.decoders import Decoder

# Points of a run; runs whose blocks are held at a time.
RUN, SLICE = 64, 64


class CodeJacobian:
    """Derivatives of the distances of N points by a code of D numbers.

    Args:
        decoder: Says what points see of a code.
        by_seen: (N,E) derivatives by each part of that.
        points: (N,3) in the unit sphere's box.
    """

    def __init__(self, decoder: Decoder, by_seen: tuple[Tensor, ...], points: Tensor) -> None:
        self.decoder, self.whole = decoder, by_seen[0]
        corners = decoder.corners(points)
        key = torch.zeros(len(points), dtype=torch.int64, device=points.device)
        for (resolution, _), (nodes, _) in zip(decoder.grids, corners, strict=True):
            key = key * resolution**3 + nodes[:, 0]
        order = key.argsort(stable=True)
        _, cell, counts = key[order].unique_consecutive(return_inverse=True, return_counts=True)
        runs = (counts + RUN - 1) // RUN
        self.count = int(runs.sum())
        self.cell = torch.arange(len(runs), device=points.device).repeat_interleave(runs)
        within = torch.arange(len(points), device=points.device) - (counts.cumsum(0) - counts)[cell]
        # Of each point, its place among those of all runs; a last run of a cell has places left over.
        self.place = torch.empty_like(order)
        self.place[order] = (runs.cumsum(0) - runs)[cell] * RUN + within
        channels = [channels for _, channels in decoder.grids]
        parts = by_seen[1].split(channels, 1) if channels else ()
        self.by = [self._in_runs(part) for part in parts]
        self.weights = [self._in_runs(weights) for _, weights in corners]
        self.nodes = [self._in_runs(nodes)[:, 0] for nodes, _ in corners]

    def forward(self, code: Tensor) -> Tensor:
        """Changes (N,) of the distances with that of a code (D,)."""
        found = self.whole @ code[: self.decoder.global_size]
        if not self.by:
            return found
        in_runs = code.new_zeros(self.count, RUN)
        for by, weights, nodes, volume in zip(self.by, self.weights, self.nodes, self._volumes(code), strict=True):
            in_runs += ((by @ volume[:, nodes].transpose(0, 1)) * weights).sum(2)
        return found + in_runs.flatten()[self.place]

    def backward(self, pull: Tensor) -> Tensor:
        """The transpose of `forward`: (N,) to (D,)."""
        return self._transposed(pull, lambda part: part)

    def squares(self, importance: Tensor) -> Tensor:
        """Squared lengths (D,) of the columns, each row as important as told, (N,)."""
        return self._transposed(importance, torch.square)

    def columns(self) -> Tensor:
        """Numbers (R,K) of a code that the points of each run see."""
        device = self.whole.device
        found = [torch.arange(self.decoder.global_size, device=device).expand(self.count, -1)]
        for first, (resolution, channels), nodes in zip(
            self.decoder.firsts, self.decoder.grids, self.nodes, strict=True
        ):
            of_channel = first + resolution**3 * torch.arange(channels, device=device)
            found.append((of_channel[:, None] + nodes[:, None]).flatten(1))
        return torch.cat(found, 1)

    def gram(self, column: Tensor, size: int, others: Tensor, importance: Tensor) -> Tensor:
        """Products of some columns with each other, each row as important as told.

        Args:
            column: (D,) which of T each number of a code is; T where it is left out.
            size: T.
            others: (N,O) columns that are dense.
            importance: (N,) of the rows, at least 0.

        Returns:
            (T+O,T+O), the dense ones last.
        """
        at = column[self.columns()]
        # What is left out goes to a place of its own.
        size, dense = size + 1, others.shape[1]
        own = torch.arange(size, size + dense, device=at.device)
        at = torch.cat([at, own.expand(self.count, -1)], 1)
        root, whole, others = (self._in_runs(x) for x in (importance.sqrt(), self.whole, others.to(self.whole)))
        found = root.new_zeros((size + dense) ** 2)
        for some in torch.arange(self.count, device=at.device).split(SLICE):
            parts = [whole[some]]
            for by, weights in zip(self.by, self.weights, strict=True):
                parts.append((by[some, :, :, None] * weights[some, :, None]).flatten(2))
            block = torch.cat([*parts, others[some]], 2) * root[some, :, None]
            # First of each cell, then all together.
            cells, cell, runs = self.cell[some].unique_consecutive(return_inverse=True, return_counts=True)
            of_cell = block.new_zeros(len(cells), *block.shape[2:] * 2).index_add_(0, cell, block.mT @ block)
            at_cell = at[some[runs.cumsum(0) - 1]]
            where = at_cell[:, :, None] * (size + dense) + at_cell[:, None]
            found.index_add_(0, where.flatten(), of_cell.flatten())
        kept = torch.cat([torch.arange(size - 1, device=at.device), own])
        return found.view(size + dense, size + dense)[kept][:, kept]

    def _transposed(self, pull: Tensor, of: Callable[[Tensor], Tensor]) -> Tensor:
        """Sums (D,) of a function of the numbers of each column times (N,)."""
        found = pull.new_zeros(self.decoder.code_size)
        found[: self.decoder.global_size] = pull @ of(self.whole)
        in_runs = self._in_runs(pull)
        for by, weights, nodes, volume in zip(self.by, self.weights, self.nodes, self._volumes(found), strict=True):
            of_run = of(by).mT @ (of(weights) * in_runs[:, :, None])
            volume.index_add_(1, nodes.flatten(), of_run.transpose(0, 1).flatten(1))
        return found

    def _volumes(self, code: Tensor) -> list[Tensor]:
        """The code's grids (C,R^3), where they lie in it."""
        return [
            code[first : first + channels * resolution**3].view(channels, -1)
            for first, (resolution, channels) in zip(self.decoder.firsts, self.decoder.grids, strict=True)
        ]

    def _in_runs(self, values: Tensor) -> Tensor:
        """Values (N,...) as (R,RUN,...); 0 where a run has no point."""
        found = values.new_zeros(self.count * RUN, *values.shape[1:])
        found[self.place] = values
        return found.unflatten(0, (self.count, RUN))
