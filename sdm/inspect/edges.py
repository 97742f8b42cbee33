"""Edges of a mesh: the faces that meet there, their directions, and the connected components."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int64, Integer

from sdm.inspect.positions import runs


@dataclass(frozen=True)
class Edges:
    """The undirected edges of a mesh, with what its faces do along them.

    Args:
        uses: (E,) how many faces have each edge.
        chain: (E,) sum of the directions in which they traverse it, +1 from the lower to the higher vertex index.
        component: (F,) which edge-connected piece each face belongs to; -1 for faces that are one point.
        components: How many pieces there are.
        component_of_edge: (E,) the piece of each edge.
        split_vertices: How many vertices join faces that no chain of edges through that vertex connects.
    """

    uses: Integer[np.ndarray, " E"]
    chain: Integer[np.ndarray, " E"]
    component: Integer[np.ndarray, " F"]
    components: int
    component_of_edge: Integer[np.ndarray, " E"]
    split_vertices: int

    @property
    def disagreeing(self) -> Bool[np.ndarray, " E"]:
        """Marks of the edges (E,) whose faces disagree which side is out."""
        return np.abs(self.chain) > self.uses % 2

    @property
    def open_components(self) -> Bool[np.ndarray, " C"]:
        """Marks of the pieces (C,) whose directed edges leave something over."""
        found = np.zeros(self.components, dtype=bool)
        found[self.component_of_edge[self.chain != 0]] = True
        return found


def edges_of(faces: Int64[np.ndarray, "F 3"], vertices: int) -> Edges:
    """The edges of faces (F,3) int64, whose indices tell positions apart.

    Faces that use a position twice are segments or points: their directed edges cancel by themselves, so they count
    for the pieces alone.
    """
    start = faces.reshape(-1)
    end = np.roll(faces, -1, 1).reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    proper = (faces != np.roll(faces, -1, 1)).all(1)

    half_edges = np.flatnonzero(low != high)
    key = low[half_edges] * vertices + high[half_edges]
    order = np.argsort(key)
    half_edges, key = half_edges[order], key[order]
    _, edge = runs(key)
    component, components = _pieces(half_edges // 3, edge, len(faces))

    real = proper[half_edges // 3]
    half_edges, key = half_edges[real], key[real]
    starts, edge = runs(key)
    forward = start[half_edges] < end[half_edges]
    split = _split_vertices(half_edges, edge, forward, start, proper)
    if len(starts) == 0:
        empty = np.zeros(0, dtype=np.int64)
        return Edges(empty, empty, component, components, empty, split)
    uses = np.diff(starts, append=len(key))
    chain = np.add.reduceat(np.where(forward, 1, -1), starts)
    return Edges(uses, chain, component, components, component[half_edges[starts] // 3], split)


def _pieces(face: np.ndarray, edge: np.ndarray, faces: int) -> tuple[np.ndarray, int]:
    """Number the faces that edges connect alike. `face` and `edge` (n,) list each face of each edge, by edge."""
    same = edge[1:] == edge[:-1]
    piece = label(face[:-1][same], face[1:][same], faces)
    has_edge = np.zeros(faces, dtype=bool)
    has_edge[face] = True
    if not has_edge.any():
        return np.full(faces, -1), 0
    used, number = np.unique(piece[has_edge], return_inverse=True)
    component = np.full(faces, -1)
    component[has_edge] = number
    return component, len(used)


def _split_vertices(
    half_edges: np.ndarray, edge: np.ndarray, forward: np.ndarray, vertex: np.ndarray, proper: np.ndarray
) -> int:
    # The corners of faces at a vertex hang together where faces share an edge at it: more than one bunch is a split.
    first = half_edges
    second = first - first % 3 + (first + 1) % 3
    low, high = np.where(forward, first, second), np.where(forward, second, first)
    same = edge[1:] == edge[:-1]
    one = np.concatenate([low[:-1][same], high[:-1][same]])
    other = np.concatenate([low[1:][same], high[1:][same]])
    bunch = label(one, other, len(vertex))
    corners = np.repeat(proper, 3)
    _, sample = np.unique(bunch[corners], return_index=True)
    bunches = np.bincount(vertex[corners][sample]) if len(sample) else np.zeros(0, dtype=np.int64)
    return int((bunches > 1).sum())


def label(
    one: Integer[np.ndarray, " n"], other: Integer[np.ndarray, " n"], count: int
) -> Integer[np.ndarray, " count"]:
    """Connected components of a graph, given its edges (n,) by their two nodes: the number of each node's component."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ones = np.ones(len(one), dtype=np.int8)
    return connected_components(coo_matrix((ones, (one, other)), shape=(count, count)), directed=False)[1]
