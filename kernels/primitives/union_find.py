"""Union-find by many threads: a forest in which every element points to one with a smaller number, a root to itself.

Two trees are merged by the smaller root (Playne and Hawick, A new algorithm for parallel connected-component labelling
on GPUs, IEEE TPDS 29(6), 2018). The trees that there are in the end do not depend on the order of the merges.
"""

from __future__ import annotations

import warp as wp

from sdm.kernels.primitives.atomics import fetch_least

wp.set_module_options({"enable_backward": False})


@wp.func
def root_of(labels: wp.array(dtype=wp.int32), number: int):
    """The root of an element's tree."""
    at = number
    up = labels[at]
    while up != at:
        further = labels[up]
        # Halves the way for whoever comes next; a write that comes late puts back an ancestor.
        labels[at] = further
        at = up
        up = further
    return at


@wp.func
def merge(labels: wp.array(dtype=wp.int32), one: int, other: int):
    """Merge the trees of two elements."""
    a = root_of(labels, one)
    b = root_of(labels, other)
    while a != b:
        low = wp.min(a, b)
        high = wp.max(a, b)
        before = fetch_least(labels, high, low)
        if before == high:
            a = low
            b = low
        else:
            # Another thread was faster: what it merged with is merged with now.
            a = root_of(labels, before)
            b = root_of(labels, low)
