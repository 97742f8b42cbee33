"""A plane through a map: its values as a picture, and lines of equal distance on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from sdm.core.signed_distance_map import SDM
from sdm.viz.figure import colour_limit, colour_map, line_step

AXES = ("x", "y", "z")
# The picture has at least so many pixels along its longer edge, so that colours run smoothly.
PIXELS = 384
MOST_LINES = 60


@dataclass(frozen=True)
class Cut:
    """A map on a plane across one of its axes.

    Args:
        image: (rows, columns, 3) uint8: rows along the second axis of the plane, columns along the first.
        size: Width and height of the picture, in the map's unit.
        position: (3,) of the picture's middle, in world coordinates.
        rotation: (3,3): columns are the directions of the plane's first and second axis, and its normal.
        lines: (N,2,3) float32 segments where the values are multiples of `step` away from the middle one.
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


def cut(field: SDM, axis: str, share: float, limit: float, centre: float = 0.0) -> Cut:
    """The values of a map on a plane, linear between voxels.

    Args:
        field: The map, on the host.
        axis: "x", "y" or "z": the grid's axis that the plane is across.
        share: Place along that axis: 0 at the first voxel, 1 at the last.
        limit: Half the range of the colours.
        centre: Value in the middle of the colours.
    """
    normal = AXES.index(axis)
    first, second = (normal + 1) % 3, (normal + 2) % 3
    grid = field.grid
    place = min(max(share, 0.0), 1.0) * (grid.shape[normal] - 1)
    below = min(int(place), max(grid.shape[normal] - 2, 0))
    pair = np.take(field.numpy(), [below, min(below + 1, grid.shape[normal] - 1)], axis=normal)
    pair = np.moveaxis(pair, (first, second, normal), (1, 0, 2))
    values = pair[..., 0] + np.float32(place - below) * (pair[..., 1] - pair[..., 0])

    edges = grid.affine[:3, :3]
    index = np.zeros(3)
    index[normal] = place
    index[first], index[second] = (grid.shape[first] - 1) / 2, (grid.shape[second] - 1) / 2
    corner = index.copy()
    corner[first] = corner[second] = 0
    rotation = np.stack([edges[:, a] / grid.spacing[a] for a in (first, second, normal)], axis=1)
    origin = grid.affine[:3, 3] + edges @ corner

    step = line_step(limit)
    middle, others = _contours(values - centre, step)
    axes = edges[:, [first, second]]
    return Cut(
        image=_picture((values - centre) / limit),
        size=(grid.spacing[first] * grid.shape[first], grid.spacing[second] * grid.shape[second]),
        position=grid.affine[:3, 3] + edges @ index,
        rotation=rotation,
        lines=_placed(others, axes, origin),
        middle=_placed(middle, axes, origin),
        step=step,
    )


def cut_away(
    vertices: Float32[np.ndarray, "v 3"], faces: Int32[np.ndarray, "f 3"], plane: Cut
) -> Int32[np.ndarray, "k 3"]:
    """The faces that lie behind the plane, with those that it crosses."""
    height = (vertices - plane.position.astype(np.float32)) @ plane.rotation[:, 2].astype(np.float32)
    return faces[(height[faces] <= 0).any(axis=1)]


def scale_of(field: SDM) -> float:
    """Half the range of the colours that suits a map."""
    return colour_limit(field.numpy())[0]


@lru_cache(maxsize=1)
def _table() -> UInt8[np.ndarray, "n 3"]:
    colours = np.asarray(colour_map()(np.linspace(0, 1, 256)))[:, :3]
    return (255 * colours + 0.5).astype(np.uint8)


def coloured(share: np.ndarray) -> UInt8[np.ndarray, "... 3"]:
    """Colours of values from -1 (deep inside, red) to 1 (far outside, blue); grey where there is no number."""
    number = np.nan_to_num((share + 1) * 127.5, nan=127.5, posinf=255, neginf=0)
    return _table()[np.clip(number, 0, 255).astype(np.uint8)]


def _picture(share: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    from scipy.ndimage import zoom

    times = max(1, math.ceil(PIXELS / max(share.shape)))
    if times > 1 and np.isfinite(share).all():
        # Voxels are areas of the picture, whose middles the values belong to.
        share = np.asarray(zoom(share, times, order=1, grid_mode=True, mode="nearest"))
    return coloured(share)


def _contours(values: np.ndarray, step: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Lines in voxels (first axis, second axis): of the value 0, and of all other multiples of the step."""
    from contourpy import contour_generator

    if min(values.shape) < 2 or not np.isfinite(values).all():
        return [], []
    make: Any = contour_generator(z=values)
    low, high = math.ceil(float(values.min()) / step), math.floor(float(values.max()) / step)
    numbers = [n for n in range(low, high + 1) if n != 0]
    if len(numbers) > MOST_LINES:
        numbers = []
    return list(make.lines(0.0)), [line for n in numbers for line in make.lines(n * step)]


def _placed(lines: list[np.ndarray], axes: np.ndarray, origin: np.ndarray) -> Float32[np.ndarray, "n 2 3"]:
    if not lines:
        return np.zeros((0, 2, 3), np.float32)
    pairs = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    return (pairs @ axes.T + origin).astype(np.float32)
