"""Connected components of a surface: the volume that each encloses, once flat caps close its gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, Integer

from sdm.inspect.edges import label

# A signed volume below this share of what it is the sum of is rounding: the component encloses nothing.
VOLUME_ROUNDING = 1e-12
# A component is nearly closed, so that it has an inside, while its caps are at most this share of its own area. A box
# without its lid has 1/5, a hemisphere 1/2, a sheet 1.
MOST_CAPS = 1 / 3


@dataclass(frozen=True)
class Components:
    """The components of a mesh, each with its size.

    Args:
        of_face: (F,) number of the component that each face belongs to; -1 for none.
        volume: (C,) signed volume of each with its caps, positive if it faces outward; 0 where that is rounding.
        area: (C,) its area, without the caps.
        caps: (C,) area of its caps, 0 for closed components.
    """

    of_face: Integer[np.ndarray, " F"]
    volume: Float64[np.ndarray, " C"]
    area: Float64[np.ndarray, " C"]
    caps: Float64[np.ndarray, " C"]

    @property
    def nearly_closed(self) -> Bool[np.ndarray, " C"]:
        """Marks of the components (C,) that have an inside: closed, or open by little."""
        return (self.area > 0) & (self.caps <= MOST_CAPS * self.area)

    @property
    def reversed(self) -> Bool[np.ndarray, " C"]:
        """Marks of the components (C,) that have an inside and face it."""
        return self.nearly_closed & (self.volume < 0)


def components_of(
    corners: Float64[np.ndarray, "F 3 3"],
    merged: Int64[np.ndarray, "F 3"],
    component: Integer[np.ndarray, " F"],
    gaps: Bool[np.ndarray, " C"],
) -> Components:
    """Measure the components of a mesh.

    Args:
        corners: (F,3,3) float64.
        merged: (F,3) vertex indices that tell positions apart.
        component: (F,) the component of each face, -1 for none.
        gaps: (C,) the components that may have gaps.

    What is left of a component's directed edges bounds its gaps. Each loop of them is closed by a fan about its middle,
    so that the volume depends on no origin.
    """
    # A first corner as the origin costs no digits where the mesh is far from its coordinates' zero.
    zero = corners[0, 0]
    a, b, c = np.moveaxis(corners - zero, 1, 0)
    own, count = component >= 0, len(gaps)
    volumes = (a * np.cross(b, c)).sum(1)[own] / 6
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)[own] / 2
    total = _sums(component[own], volumes, count)
    size = _sums(component[own], np.abs(volumes), count)
    area = _sums(component[own], areas, count)
    caps = np.zeros(count)
    number, low, high, times = borders_of(merged, component, gaps)
    if len(number):
        position = np.empty((int(merged.max()) + 1, 3))
        position[merged.reshape(-1)] = corners.reshape(-1, 3) - zero
        volumes, areas = _fans(position, number, low, high, times)
        total += _sums(number, volumes, count)
        size += _sums(number, np.abs(volumes), count)
        caps = _sums(number, areas, count)
    return Components(component, np.where(np.abs(total) > VOLUME_ROUNDING * size, total, 0.0), area, caps)


def borders_of(
    merged: Int64[np.ndarray, "F 3"], component: Integer[np.ndarray, " F"], gaps: Bool[np.ndarray, " C"]
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"], Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Border edges of each component with gaps: those left over of its directed edges.

    Returns:
        The component, the lower vertex, the higher, and how often the edge leads up, less how often back: (n,) each.
    """
    following = np.roll(merged, -1, 1)
    used = (
        np.flatnonzero((component >= 0) & gaps[component] & (merged != following).all(1))
        if gaps.any()
        else component[:0]
    )
    start, end, number = merged[used].reshape(-1), following[used].reshape(-1), np.repeat(component[used], 3)
    low, high, times = np.minimum(start, end), np.maximum(start, end), np.where(start < end, 1, -1)
    if len(number) == 0:
        return number, low, high, times
    key = low * (int(merged.max()) + 1) + high
    order = np.lexsort((key, number))
    key, number, times = key[order], number[order], times[order]
    begin = np.flatnonzero(np.concatenate([[True], (key[1:] != key[:-1]) | (number[1:] != number[:-1])]))
    times = np.add.reduceat(times, begin)
    left = times != 0
    begin, times = begin[left], times[left]
    return number[begin], low[order[begin]], high[order[begin]], times


def _sums(number: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    # Of no values NumPy gives whole numbers.
    return np.bincount(number, values, minlength=count).astype(np.float64)


def _fans(
    position: np.ndarray, number: np.ndarray, low: np.ndarray, high: np.ndarray, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Signed volume and area of the cap's triangle at each border edge (n,)."""
    # Components that touch at a vertex have loops of their own.
    width = len(position)
    ends, index = np.unique(np.concatenate([number * width + low, number * width + high]), return_inverse=True)
    one, other = index[: len(low)], index[len(low) :]
    loop = label(one, other, len(ends))[one]
    weight = np.abs(times).astype(np.float64)
    loops = int(loop.max()) + 1
    ways = np.bincount(loop, weight, minlength=loops)
    middle = (position[low] + position[high]) / 2
    centre = np.stack([np.bincount(loop, weight * middle[:, k], minlength=loops) for k in range(3)], 1) / ways[:, None]
    apex, a, b = centre[loop], position[high], position[low]
    volumes = times * (apex * np.cross(a, b)).sum(1) / 6
    return volumes, weight * np.linalg.norm(np.cross(a - apex, b - apex), axis=1) / 2
