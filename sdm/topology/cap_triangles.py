"""Caps: triangles that close the holes of a mesh, between vertices of their rims.

The boundary edges are cut into simple cycles (`sdm.kernels.topology.boundary_cycles`), and each cycle of n edges is
closed by n - 2 triangles: over every two edges one that cuts off the vertex between them, over every two of its new
edges another one, and so on. So a long cycle has large triangles only in its middle, few of them, and a hole that a
single triangle has left is closed by just that triangle.
"""

from __future__ import annotations

import numpy as np
import torch
import warp as wp
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from sdm.kernels.topology.boundary_cycles import Walk, split_cycles
from sdm.runtime.torch_warp import array_at
from sdm.topology.boundary_edges import on_host
from sdm.topology.face_pairing import Pairing, cached

_known: WeakIdKeyDictionary = WeakIdKeyDictionary()
_known_turned: WeakIdKeyDictionary = WeakIdKeyDictionary()


def cap_triangles(edges: Tensor) -> Tensor:
    """Triangles (E,3) int32 that close a mesh with these boundary edges (E,2), directed as `boundary_edges` gives them.

    Together with the mesh's faces they leave no boundary edge. Two of each cycle have corners at one vertex, and so no
    area: as many triangles as edges are a simpler thing to count.
    """
    return cached(_known, edges, lambda: torch.from_numpy(caps_on_host(on_host(edges))).to(edges.device))


def turned_faces(faces: Tensor) -> Tensor:
    """Faces (F,3) int32 inside out: they close any mesh, of which nothing is left then."""
    return cached(_known_turned, faces, lambda: turned(faces))


def turned(faces: Tensor) -> Tensor:
    """`turned_faces`, made anew by one operation, so that it may be recorded."""
    # A list of columns would be copied to the device first.
    return torch.stack([faces[:, 0], faces[:, 2], faces[:, 1]], 1)


def remember_joined(pairing: Pairing, edges: Tensor, caps: Tensor) -> None:
    """Remember boundary edges and their caps, which were found on the device, as those of a pairing."""
    pairing.edges, pairing.same = edges, None
    remember_caps(edges, caps)


def remember_caps(edges: Tensor, caps: Tensor) -> None:
    """Remember caps (E,3) of boundary edges (E,2), for `cap_triangles`."""
    cached(_known, edges, lambda: caps)


def caps_on_host(edges: np.ndarray) -> np.ndarray:
    """`cap_triangles` of an array."""
    ends, index = np.unique(edges, return_inverse=True)
    start, end = index.reshape(-1, 2).astype(np.int32).T
    order, begins = _cycles(np.ascontiguousarray(start), np.ascontiguousarray(end), len(ends))
    length = np.diff(np.append(begins, len(edges)))
    number = np.repeat(np.arange(len(begins)), length)
    at, long = np.arange(len(edges)) - begins[number], length[number]
    # How many edges of the cycle are before its lowest vertex.
    lowest = np.minimum.reduceat(start[order], begins)[number]
    turn = np.add.reduceat(np.where(start[order] == lowest, at, 0), begins)[number]
    left = (turn - at) % long
    step = left & -left

    def vertex(left: np.ndarray) -> np.ndarray:
        """The vertex with so many edges between it and the cycle's lowest one."""
        return ends[start[order[begins[number] + (turn - left) % long]]]

    caps = np.empty((len(edges), 3), np.int32)
    caps[order] = np.stack([vertex(left - step), vertex(left), vertex(np.where(left + step < long, left + step, 0))], 1)
    return caps


def small_caps(edges: Tensor, vertices: Tensor, size: float) -> Tensor:
    """Those of `cap_triangles` that close holes which fit into a ball.

    Args:
        edges: (E,2) int32, directed boundary edges.
        vertices: (V,3) float32.
        size: The ball's diameter. Its middle is that of the hole's rim: the mean of its vertices.

    Returns:
        (C,3) int32.
    """
    host = on_host(edges)
    if len(host) == 0:
        return edges.new_empty((0, 3))
    ends, index = np.unique(host, return_inverse=True)
    start, end = index.reshape(-1, 2).astype(np.int32).T
    order, begins = _cycles(np.ascontiguousarray(start), np.ascontiguousarray(end), len(ends))
    length = np.diff(np.append(begins, len(host)))
    rim = (
        vertices.detach()[torch.from_numpy(host[order, 0].astype(np.int64)).to(vertices.device)].cpu().double().numpy()
    )
    middle = np.add.reduceat(rim, begins) / length[:, None]
    away = np.linalg.norm(rim - np.repeat(middle, length, 0), axis=1)
    small = np.zeros(len(host), bool)
    small[order] = np.repeat(2 * np.maximum.reduceat(away, begins) <= size, length)
    return cap_triangles(edges)[torch.from_numpy(small).to(edges.device)].contiguous()


def _cycles(start: np.ndarray, end: np.ndarray, vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """The edges from `start` to `end` cycle by cycle, and where each cycle begins among them."""
    count = len(start)
    leaving = np.argsort(start, kind="stable").astype(np.int32)
    first = np.searchsorted(start[leaving], np.arange(vertices + 1)).astype(np.int32)
    arrays = {
        "ends": end,
        "leaving": leaving,
        "first": first,
        "used": first[:-1].copy(),
        "place": np.full(vertices, -1, np.int32),
        "path": np.empty(count, np.int32),
        "order": np.empty(count, np.int32),
        "cycle": np.empty(count, np.int32),
    }
    walk = Walk()
    for name, array in arrays.items():
        setattr(walk, name, array_at(array.ctypes.data, array.shape, wp.int32, torch.device("cpu")))
    split_cycles(walk)
    return arrays["order"], np.flatnonzero(np.diff(arrays["cycle"], prepend=-1))
