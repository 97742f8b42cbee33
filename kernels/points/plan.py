"""Plan of a query at scattered points: its path, and how it is shared out."""
# pyright: basic

from __future__ import annotations

from typing import NamedTuple

from sdm.kernels.plan_options import PlanOptions
from sdm.kernels.points.packets import PACKET

# Neighbours along the curve that one thread takes one after the other, each from the answer before it. A GPU would
# rather have more threads.
CPU_RUN = 32
# Packets that keep a GPU busy: of fewer points each packet has less than there is room for. With twice as many single
# calls are faster still, and lists of meshes slower (bench/decisions/0080-signs-of-points-near-holes.md).
BUSY = 1 << 11


class PointsPlan(NamedTuple):
    """Decisions about a query at scattered points.

    Args:
        lists: True for the fast path, by lists of triangles for packets of points; else only the plain one.
        packets: Packets of neighbours along the curve.
        run: Neighbours that one thread of the plain path takes.
        share: Points of each packet, at most PACKET.
    """

    lists: bool
    packets: int
    run: int
    share: int = PACKET


def share_of(count: int) -> int:
    """Points of each packet of so many about one mesh, on the path by lists.

    Points of few packets are far apart: their lists are too long, and each lane searches by itself.
    """
    share = PACKET
    while share > 1 and count < BUSY * share:
        share //= 2
    return share


def plan_points(count: int, gpu: bool, options: PlanOptions, in_packets: bool = False) -> PointsPlan:
    """The plan of a query at so many points, or at so many places of packets that are there (`in_packets`)."""
    method = options.points_method
    # One lane goes through a list slower than down the tree.
    lists = method == "lists" or (method == "auto" and gpu)
    share = share_of(count) if lists and not in_packets else PACKET
    return PointsPlan(lists, -(-count // share), 1 if gpu else CPU_RUN, share)
