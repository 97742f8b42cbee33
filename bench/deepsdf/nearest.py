"""The nearest of millions of points on the device: the answers of a KD-tree on the host, in milliseconds."""
# Warp compiles a subset of Python, in which int(0) is a variable.
# ruff: noqa: RUF046, UP018
# Warp's own compiler checks the types inside kernels, by rules that are not Python's.
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportIndexIssue=false
# pyright: reportOperatorIssue=false

from __future__ import annotations

import math

import torch
import warp as wp
from torch import Tensor

from sdm.bench.peers.warp import on_torch_stream
from sdm.kernels.bvh.tree import box_distance2
from sdm.kernels.geometry.hilbert import FINE_BITS, curve_code
from sdm.kernels.launch import launch

# How many neighbours are looked for: as many as vote on a sign in DeepSDF's preprocessing.
VOTES = 11
LEAF = 8
# As fine as a curve through many points should be.
CURVE_BITS = FINE_BITS

Distances = wp.types.vector(length=VOTES, dtype=wp.float32)
Numbers = wp.types.vector(length=VOTES, dtype=wp.int32)
# One entry a level.
Waiting = wp.types.vector(length=32, dtype=wp.int32)
WaitingDistances = wp.types.vector(length=32, dtype=wp.float32)


@wp.kernel(enable_backward=False)
def _code(begin: int, points: wp.array[wp.vec3], low: wp.vec3, high: wp.vec3, codes: wp.array[wp.int64]):
    i = begin + wp.tid()
    codes[i] = curve_code(points[i], low, high, CURVE_BITS)


@wp.kernel(enable_backward=False)
def _search(
    begin: int,
    points: wp.array[wp.vec3],
    low: wp.array[wp.vec3],
    high: wp.array[wp.vec3],
    leaves: int,
    queries: wp.array[wp.vec3],
    found: wp.array2d[wp.int32],
):
    """Near children first; a node further away than the last of the best is left out."""
    q = begin + wp.tid()
    p = queries[q]
    best = Distances()
    number = Numbers()
    for i in range(VOTES):
        best[i] = wp.inf
        number[i] = -1
    nodes = Waiting()
    distances = WaitingDistances()
    waiting = int(0)
    node = int(1)
    while node > 0:
        if node >= leaves:
            first = (node - leaves) * LEAF
            for n in range(first, first + LEAF):
                d = wp.length_sq(points[n] - p)
                if d < best[VOTES - 1]:
                    # The new one sinks to its place, the last falls out.
                    this = n
                    for i in range(VOTES):
                        if d < best[i]:
                            other = best[i]
                            best[i] = d
                            d = other
                            swapped = number[i]
                            number[i] = this
                            this = swapped
            node = int(0)
        else:
            near = 2 * node
            far = near + 1
            near2 = box_distance2(p, low[near], high[near])
            far2 = box_distance2(p, low[far], high[far])
            if far2 < near2:
                near = far
                far = 2 * node
                swap = near2
                near2 = far2
                far2 = swap
            if far2 < best[VOTES - 1]:
                nodes[waiting] = far
                distances[waiting] = far2
                waiting = waiting + 1
            node = wp.where(near2 < best[VOTES - 1], near, 0)
        while node == 0 and waiting > 0:
            waiting = waiting - 1
            if distances[waiting] < best[VOTES - 1]:
                node = nodes[waiting]
    for i in range(VOTES):
        found[q, i] = number[i]


class Nearest:
    """Exact nearest neighbours among fixed points (N,3), N at least VOTES, on their device.

    The points are sorted along a Hilbert curve, every `LEAF` of them are a leaf of a complete binary tree of boxes.
    """

    def __init__(self, points: Tensor) -> None:
        if len(points) < VOTES:
            raise ValueError(f"{len(points)} points have no {VOTES} nearest ones")
        self._low, self._high = (points.aminmax(dim=0)[n].tolist() for n in (0, 1))
        self._order = self._along_curve(points)
        self._leaves = 1 << max(0, math.ceil(math.log2(len(points) / LEAF)))
        # Points that fill the last leaves are infinitely far: they are never found, and their boxes never entered.
        filled = points.new_full((self._leaves * LEAF, 3), math.inf)
        filled[: len(points)] = points[self._order]
        self._points = filled
        leaf = filled.reshape(-1, LEAF, 3)
        self._boxes = _levels(leaf.amin(1), "amin"), _levels(leaf.amax(1), "amax")

    def __call__(self, queries: Tensor) -> Tensor:
        """Numbers (M,VOTES) int64 of the points nearest to queries (M,3), nearest first."""
        order = self._along_curve(queries)
        found = torch.empty(len(queries), VOTES, dtype=torch.int32, device=queries.device)
        device = str(queries.device)
        with on_torch_stream(device):
            points, low, high, at = (
                wp.from_torch(t, dtype=wp.vec3) for t in (self._points, *self._boxes, queries[order].contiguous())
            )
            inputs = [points, low, high, self._leaves, at, wp.from_torch(found)]
            launch(_search, len(queries), inputs, device)
        result = torch.empty_like(found, dtype=torch.int64)
        result[order] = self._order[found.long()]
        return result

    def _along_curve(self, points: Tensor) -> Tensor:
        """The order of points (N,3) along the curve: neighbouring threads go the same way."""
        codes = torch.empty(len(points), dtype=torch.int64, device=points.device)
        with on_torch_stream(str(points.device)):
            at = wp.from_torch(points.contiguous(), dtype=wp.vec3)
            inputs = [at, wp.vec3(*self._low), wp.vec3(*self._high), wp.from_torch(codes)]
            launch(_code, len(points), inputs, str(points.device))
        return codes.argsort()


def _levels(leaves: Tensor, reduce: str) -> Tensor:
    """A corner of the boxes (2L,3) of a complete tree, the root at 1, from those of its L leaves."""
    levels = [leaves]
    while len(levels[0]) > 1:
        levels.insert(0, getattr(levels[0].reshape(-1, 2, 3), reduce)(1))
    return torch.cat([leaves[:1], *levels]).contiguous()
