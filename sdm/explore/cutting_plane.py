"""A plane through a map: its values as a picture, and lines of equal distance on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.explore.controls import Planes, Shown
from sdm.viz.figure import colour_limit, line_step
from sdm.viz.style import colour_map

AXES = ("x", "y", "z")
# The picture has at least so many pixels along its longer edge, so that colours run smoothly.
PIXELS = 256
MOST_LINES = 60
# Of the lines beyond the colours, one of so many is drawn.
SPARSE = 5


@dataclass(frozen=True)
class Cut:
    """A map on a plane across one of its axes.

    Args:
        image: (rows, columns, 3) uint8: rows along the second axis of the plane, columns along the first.
        size: Width and height of the picture, in the map's unit.
        position: (3,) of the picture's middle, in world coordinates.
        rotation: (3,3): columns are the directions of the plane's first and second axis, and its normal.
        lines: (N,2,3) float32 segments where the values are multiples of `step` away from the middle one; of those
            beyond the colours each fifth.
        middle: (M,2,3) float32 segments where they are the middle one: of distances, the surface.
        step: Between lines.
    """

    image: UInt8[np.ndarray, "h w 3"]
    size: tuple[float, float]
    position: np.ndarray
    rotation: np.ndarray
    lines: Float32[np.ndarray, "n 2 3"]
    middle: Float32[np.ndarray, "m 2 3"]
    step: float


def cut(shown: Shown, axis: str, share: float, limit: float) -> Cut:
    """The map of what is shown on a plane, linear between voxels.

    Args:
        shown: With its map on the host.
        axis: "x", "y" or "z": the grid's axis that the plane is across.
        share: Place along that axis: 0 at the first voxel, 1 at the last.
        limit: Half the range of the colours.
    """
    normal = AXES.index(axis)
    first, second = (normal + 1) % 3, (normal + 2) % 3
    grid = shown.field.grid
    place = min(max(share, 0.0), 1.0) * (grid.shape[normal] - 1)
    values = on_plane(shown.field, normal, place).T - shown.centre

    edges = grid.affine[:3, :3]
    index = np.zeros(3)
    index[normal] = place
    index[first], index[second] = (grid.shape[first] - 1) / 2, (grid.shape[second] - 1) / 2
    corner = index.copy()
    corner[first] = corner[second] = 0
    rotation = np.stack([edges[:, a] / grid.spacing[a] for a in (first, second, normal)], axis=1)
    origin = grid.affine[:3, 3] + edges @ corner

    step = line_step(limit)
    if shown.outline is None:
        middle, others = _contours(values, step, limit)
    else:
        middle, others = _contours(on_plane(shown.outline, normal, place).T, math.inf, limit)
    axes = edges[:, [first, second]]
    return Cut(
        image=_picture(values / limit, grey=shown.grey),
        size=(grid.spacing[first] * grid.shape[first], grid.spacing[second] * grid.shape[second]),
        position=grid.affine[:3, 3] + edges @ index,
        rotation=rotation,
        lines=_placed(others, axes, origin),
        middle=_placed(middle, axes, origin),
        step=step,
    )


def on_plane(field: SDM | Planes, axis: int, place: float) -> Float32[np.ndarray, "n m"]:
    """Values on the plane across an axis at a place in voxels, along the two axes that follow it (x, y, z, x)."""
    if not isinstance(field, SDM):
        return field.on_plane(axis, place)
    count = field.grid.shape[axis]
    below = min(int(place), max(count - 2, 0))
    values = field.numpy()
    low, high = (np.take(values, min(below + n, count - 1), axis=axis) for n in (0, 1))
    found = low + np.float32(place - below) * (high - low)
    # What is left of (x, y, z) is in their order, and of y it is (x, z).
    return found.T if axis == 1 else found


def place_of(grid: Grid, axis: str, point: np.ndarray) -> float:
    """The share of the way along an axis, 0 to 1, of the plane through a point of the world (3,)."""
    normal = AXES.index(axis)
    along = (point - grid.affine[:3, 3]) @ grid.affine[:3, normal] / grid.spacing[normal] ** 2
    return float(np.clip(along / max(grid.shape[normal] - 1, 1), 0.0, 1.0))


def cut_away(
    vertices: Float32[np.ndarray, "v 3"], faces: Int32[np.ndarray, "f 3"], plane: Cut
) -> Int32[np.ndarray, "k 3"]:
    """The faces that lie behind the plane, with those that it crosses."""
    height = (vertices - plane.position.astype(np.float32)) @ plane.rotation[:, 2].astype(np.float32)
    return faces[(height[faces] <= 0).any(axis=1)]


def scale_of(field: SDM | Planes) -> float:
    """Half the range of the colours that suits a map."""
    values = field.numpy() if isinstance(field, SDM) else on_plane(field, 1, (field.grid.shape[1] - 1) / 2)
    return colour_limit(values)[0]


@lru_cache(maxsize=2)
def _table(*, grey: bool) -> UInt8[np.ndarray, "n 3"]:
    steps = np.linspace(0, 1, 256)
    colours = np.repeat(steps[:, None], 3, 1) if grey else np.asarray(colour_map()(steps))[:, :3]
    return (255 * colours + 0.5).astype(np.uint8)


def coloured(share: np.ndarray, *, grey: bool = False) -> UInt8[np.ndarray, "... 3"]:
    """Colours of values from -1 (deep inside, red) to 1 (far outside, blue); grey where there is no number."""
    number = np.nan_to_num((share + 1) * 127.5, nan=127.5, posinf=255, neginf=0)
    return _table(grey=grey)[np.clip(number, 0, 255).astype(np.uint8)]


def _picture(share: np.ndarray, *, grey: bool) -> UInt8[np.ndarray, "h w 3"]:
    times = max(1, math.ceil(PIXELS / max(share.shape)))
    if times > 1 and np.isfinite(share).all():
        for axis in (0, 1):
            below, above, part = _between(share.shape[axis], times)
            low, high = share.take(below, axis), share.take(above, axis)
            share = low + (part if axis else part[:, None]) * (high - low)
    return coloured(share, grey=grey)


@lru_cache(maxsize=16)
def _between(count: int, times: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each of count * times pixels the voxels between whose middles it lies, and its place between them."""
    place = np.clip((np.arange(count * times) + 0.5) / times - 0.5, 0, count - 1)
    below = np.minimum(place.astype(int), max(count - 2, 0))
    return below, np.minimum(below + 1, count - 1), (place - below).astype(np.float32)


def _contours(values: np.ndarray, step: float, limit: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Lines in voxels (first axis, second axis): of the value 0, and of all other multiples of the step."""
    from contourpy import contour_generator

    if min(values.shape) < 2 or not np.isfinite(values).all():
        return [], []
    make: Any = contour_generator(z=values)
    low, high = math.ceil(float(values.min()) / step), math.floor(float(values.max()) / step)
    numbers = [n for n in range(low, high + 1) if n != 0 and (abs(n * step) <= limit or n % SPARSE == 0)]
    if len(numbers) > MOST_LINES:
        numbers = []
    return list(make.lines(0.0)), [line for n in numbers for line in make.lines(n * step)]


def _placed(lines: list[np.ndarray], axes: np.ndarray, origin: np.ndarray) -> Float32[np.ndarray, "n 2 3"]:
    if not lines:
        return np.zeros((0, 2, 3), np.float32)
    pairs = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    return (pairs @ axes.T + origin).astype(np.float32)
