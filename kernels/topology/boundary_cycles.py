"""Simple cycles of boundary edges: every cycle comes back to its first vertex and to no other.

A walk along the edges cuts off a cycle whenever it comes to a vertex that it has been to. As many edges end at each
vertex as begin there, so it never gets stuck, and all edges are used up. Cycles are short where they can be: an edge
that closes one at once is taken before any other, the shortest first.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.launch import launch

wp.set_module_options({"enable_backward": False})


@wp.struct
class Walk:
    """Edges of which each begins at one of `vertices` and ends at another, and the state of the walk along them."""

    ends: wp.array(dtype=wp.int32)  # (edges) where each edge leads
    leaving: wp.array(dtype=wp.int32)  # (edges) the edges by the vertex that they begin at; used ones come first
    first: wp.array(dtype=wp.int32)  # (vertices + 1) where those of each vertex begin in `leaving`
    used: wp.array(dtype=wp.int32)  # (vertices) one past the last used one, as `first` at the beginning
    place: wp.array(dtype=wp.int32)  # (vertices) where on the path each vertex is, -1 if it is not
    path: wp.array(dtype=wp.int32)  # (edges) edges that belong to no cycle yet, one after the other
    order: wp.array(dtype=wp.int32)  # (edges) filled: the edges of a cycle one after the other, then those of the next
    cycle: wp.array(dtype=wp.int32)  # (edges) filled: the cycle's number at each place of `order`


@wp.func
def take_edge(walk: Walk, vertex: int):
    """An unused edge that leaves a vertex, from now on used: one that closes the shortest cycle, if one closes any."""
    begin = walk.used[vertex]
    best = begin
    for i in range(begin + 1, walk.first[vertex + 1]):
        if walk.place[walk.ends[walk.leaving[i]]] > walk.place[walk.ends[walk.leaving[best]]]:
            best = i
    edge = walk.leaving[best]
    walk.leaving[best] = walk.leaving[begin]
    walk.leaving[begin] = edge
    walk.used[vertex] = begin + 1
    return edge


@wp.kernel
def _split(begin: int, vertices: int, walk: Walk):
    """One thread for the whole walk."""
    done = int(0)
    cycles = int(0)
    # Not constants, which Warp would write out.
    count = vertices + begin + wp.tid()
    for start in range(count):
        while walk.used[start] < walk.first[start + 1]:
            length = int(0)
            vertex = start
            walk.place[vertex] = 0
            walking = bool(True)
            while walking:
                edge = take_edge(walk, vertex)
                walk.path[length] = edge
                length = length + 1
                vertex = walk.ends[edge]
                back = walk.place[vertex]
                if back < 0:
                    walk.place[vertex] = length
                else:
                    for i in range(back, length):
                        passed = walk.path[i]
                        walk.order[done] = passed
                        walk.cycle[done] = cycles
                        done = done + 1
                        walk.place[walk.ends[passed]] = -1
                    cycles = cycles + 1
                    length = back
                    walk.place[vertex] = back
                    walking = length > 0
            walk.place[start] = -1


def split_cycles(walk: Walk) -> None:
    """Fill a walk's `order` and `cycle`, on the CPU."""
    launch(_split, 1, [walk.place.shape[0], walk], "cpu")
