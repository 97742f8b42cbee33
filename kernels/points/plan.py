"""Plan of a query at scattered points: its path, and how it is shared out."""
# pyright: basic

from __future__ import annotations

from typing import NamedTuple

from sdm.kernels.plan_options import PlanOptions
from sdm.kernels.points.packets import PACKET

# Neighbours along the curve that one thread takes one after the other, each from the answer before it. A GPU would
# rather have more threads.
CPU_RUN = 32


class PointsPlan(NamedTuple):
    """Decisions about a query at scattered points.

    Args:
        lists: True for the fast path, by lists of triangles for packets of points; else only the plain one.
        packets: Packets of neighbours along the curve.
        run: Neighbours that one thread of the plain path takes.
    """

    lists: bool
    packets: int
    run: int


def plan_points(count: int, gpu: bool, options: PlanOptions) -> PointsPlan:
    """The plan of a query at so many points."""
    method = options.points_method
    # One lane goes through a list slower than down the tree.
    lists = method == "lists" or (method == "auto" and gpu)
    return PointsPlan(lists, -(-count // PACKET), 1 if gpu else CPU_RUN)
