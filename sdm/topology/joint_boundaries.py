"""Boundary edges of meshes that differ, found together: what is a boundary of all is one of each.

To those who join ends that are at one place the meshes are one, which is there twice: once as it is, and once with each
vertex at its mesh's number. So ends at one place are of one mesh, and what comes of it is bit for bit what each mesh
has by itself, as vertices and edges are in the same order.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
import warp as wp
from torch import Tensor

from sdm.kernels.topology.boundary_flags import ALL_EDGES, ALL_UNMATCHED, FLAGS, NUMBERS
from sdm.kernels.topology.boundary_loops import join_edges
from sdm.kernels.topology.many_loops import cap_many_loops
from sdm.runtime.torch_warp import as_warp, on_current_stream, to_device, workspace
from sdm.topology import device_joining
from sdm.topology.boundary_edges import MOST_ON_HOST, joined_on_host
from sdm.topology.cap_triangles import caps_on_host
from sdm.topology.joining import join_on_device


class JointBoundaries(NamedTuple):
    """Boundary edges of meshes that differ.

    Args:
        edges: (E,2) int32, by the numbers of their vertices among all: those of each mesh follow each other, as
            `boundary_edges` gives them.
        begins: (meshes + 1) of each mesh its first edge, and behind them their end.
    """

    edges: Tensor
    begins: list[int]

    @property
    def counts(self) -> list[int]:
        """Of each mesh how many it has."""
        return [end - begin for begin, end in pairwise(self.begins)]

    def of_some(self, meshes: Sequence[int]) -> Tensor:
        """The edges of some meshes, one behind the other."""
        return torch.cat([self.edges[:0], *(self.edges[self.begins[i] : self.begins[i + 1]] for i in meshes)])


def joint_boundaries(unmatched: Tensor, found: Tensor, vertices: Tensor, counts: Tensor) -> JointBoundaries:
    """The boundary edges of meshes whose faces were paired as those of one.

    Args:
        unmatched: (N,3) int32, one at least, as `sdm.topology.face_pairing.queue_pairing` gives them.
        found: (2,) int32, its flags.
        vertices: (V,3) float32, of all meshes in a row.
        counts: (meshes,) int32, of each how many it has.

    Waits for a GPU once, or three times where edges come many times over.
    """
    meshes, device = counts.shape[0], vertices.device
    numbers = torch.arange(meshes, dtype=torch.float32, device=device)
    numbers = numbers.repeat_interleave(counts, output_size=vertices.shape[0])
    twice = torch.stack([vertices, numbers[:, None].expand(-1, 3)])
    firsts = torch.cat([counts.new_zeros(1), counts.cumsum(0, dtype=torch.int32)])
    if device.type in device_joining.JOINING_DEVICES:
        joined = _by_kernels(unmatched, found, twice, firsts)
        if joined is not None:
            return joined
    elif unmatched.shape[0] <= MOST_ON_HOST:
        _, host = joined_on_host(unmatched, twice)
        begins = np.searchsorted(host.min(1), firsts.numpy())
        return JointBoundaries(torch.from_numpy(host), begins.tolist())
    edges = join_on_device(unmatched, twice)
    return JointBoundaries(edges, torch.searchsorted(edges.amin(1), firsts).tolist())


def _by_kernels(unmatched: Tensor, found: Tensor, twice: Tensor, firsts: Tensor) -> JointBoundaries | None:
    """The same with room for as many edges as are unmatched; None if there are more."""
    rows = unmatched.shape[0]
    numbers, flat = torch.zeros(NUMBERS + 2 * rows, dtype=torch.int32, device=twice.device).split([NUMBERS, 2 * rows])
    edges = flat.view(rows, 2)
    with on_current_stream(twice, twice, unmatched, found):
        join_edges(
            as_warp(unmatched, wp.int32),
            as_warp(found, wp.int32),
            as_warp(twice, wp.vec3),
            as_warp(edges, wp.int32),
            None,
            as_warp(numbers, wp.int32),
            workspace(twice.device),
            in_room=True,
        )
    # Rows that are not there are behind all others.
    is_there = torch.arange(rows, dtype=torch.int32, device=twice.device) < numbers[ALL_EDGES]
    lower = torch.where(is_there, edges.amin(1), firsts[-1])
    said = torch.cat([numbers[:FLAGS], torch.searchsorted(lower, firsts, out_int32=True)]).tolist()
    if any(said[:FLAGS]):
        return None
    begins = said[FLAGS:]
    return JointBoundaries(edges[: begins[-1]], begins)


def caps_of(edges: Tensor, vertices: int) -> Tensor:
    """Triangles (E,3) int32 that close the holes of meshes with these boundary edges (E,2), of so many vertices.

    As `sdm.topology.cap_triangles.cap_triangles` gives them, save that on a GPU loops that meet may be cut otherwise.
    Does not wait for it.
    """
    count, device = edges.shape[0], edges.device
    if count == 0 or device.type not in device_joining.JOINING_DEVICES:
        return torch.from_numpy(caps_on_host(edges.cpu().numpy())).to(device) if count else edges.new_empty((0, 3))
    numbers = [0] * NUMBERS
    numbers[ALL_UNMATCHED] = numbers[ALL_EDGES] = count
    flags = to_device(torch.tensor(numbers, dtype=torch.int32, device="cpu"), device)
    caps = torch.empty(count, 3, dtype=torch.int32, device=device)
    with on_current_stream(edges, edges, flags):
        cap_many_loops(
            as_warp(edges, wp.int32),
            as_warp(caps, wp.int32),
            as_warp(flags, wp.int32),
            vertices,
            workspace(device),
        )
    return caps
