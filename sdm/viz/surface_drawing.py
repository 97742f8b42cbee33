"""The surface of a map as a lit solid in a matplotlib figure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import SDMError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

# matplotlib sorts and paints triangles one by one: past this many voxels along an axis it takes minutes.
LARGEST_AXIS = 160
ELEVATION, AZIMUTH = 36.0, -58.0
BASE_COLOUR = np.array([0.86, 0.45, 0.38])
INNER_COLOUR = np.array([0.45, 0.47, 0.52])


def draw_surface(figure: Figure, place: tuple[float, float, float, float], field: SDM, unit: str | None) -> None:
    """Draw where `field` is zero at `place` (left, bottom, width, height, shares of the figure).

    The light comes from the upper left of the eye. Hollows are darker: along the outward normal the distance
    grows as fast as one moves away, unless something else of the surface is near.
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    coarse = _drawable(field)
    try:
        mesh = coarse.to_mesh()
    except SDMError:
        return _say_nothing_there(figure, place, field)
    vertices, faces = mesh.numpy()
    corners = vertices.astype(np.float64)[faces]
    colours = _colours(coarse, corners)

    axes = cast("Axes3D", figure.add_axes(place, projection="3d", computed_zorder=False))
    solid = Poly3DCollection(corners, facecolors=colours, edgecolors=colours, linewidths=0.25, zsort="average")
    axes.add_collection3d(solid)
    low, high = corners.min((0, 1)), corners.max((0, 1))
    pad = 0.04 * float((high - low).max()) or 1.0
    axes.set(xlim=(low[0] - pad, high[0] + pad), ylim=(low[1] - pad, high[1] + pad), zlim=(low[2] - pad, high[2] + pad))
    axes.set_box_aspect(high - low + 2 * pad)
    axes.view_init(elev=ELEVATION, azim=AZIMUTH)
    axes.set_proj_type("persp", focal_length=1.6)
    suffix = f" [{unit}]" if unit else ""
    for name in "xyz":
        axis: Any = getattr(axes, f"{name}axis")
        axis.set_pane_color((0.965, 0.968, 0.975, 1.0))
        axis.set_label_text(name + suffix)
    axes.tick_params(labelsize=8, pad=1)
    axes.locator_params(nbins=5)
    axes.grid(visible=True)
    return None


def _drawable(field: SDM) -> SDM:
    """Every n-th voxel of a map that is too large to draw, and the farthest distance where there is none."""
    grid = field.grid
    steps = [math.ceil(n / LARGEST_AXIS) for n in grid.shape]
    values = field.values.detach()[:: steps[0], :: steps[1], :: steps[2]].cpu()
    finite = values[values.isfinite()]
    if finite.numel():
        values = values.nan_to_num(float(finite.max()), float(finite.max()), float(finite.min()))
    spacing = tuple(s * n for s, n in zip(grid.spacing, steps, strict=True))
    return SDM(values, Grid(grid.origin, spacing, values.shape, grid.direction))


def _colours(field: SDM, corners: np.ndarray) -> np.ndarray:
    """(F,3) colours of the triangles `corners` (F,3,3) under the light."""
    from scipy.ndimage import map_coordinates

    values, grid = field.numpy(), field.grid
    inverse = np.linalg.inv(grid.affine)
    rotation = np.asarray(grid.direction)

    def at(volume: np.ndarray, points: np.ndarray) -> np.ndarray:
        index = points @ inverse[:3, :3].T + inverse[:3, 3]
        return map_coordinates(volume, index.T, order=1, mode="nearest")

    centres = corners.mean(1)
    slopes = [at(np.gradient(values, grid.spacing[a], axis=a), centres) for a in range(3)]
    normals = np.stack(slopes, -1) @ rotation.T
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)

    reach = 0.035 * float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    openness = np.ones(len(centres))
    for step, weight in ((1.0, 0.2), (2.5, 0.3), (5.0, 0.3)):
        away = step * reach
        openness -= weight * np.clip(1.0 - at(values, centres + away * normals) / away, 0.0, 1.0)

    eye, light = _direction(ELEVATION, AZIMUTH), _direction(52.0, AZIMUTH - 42.0)
    fill = _direction(15.0, AZIMUTH + 70.0)
    facing = np.einsum("fi,fi->f", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), eye[None])
    diffuse = np.clip(normals @ light, 0, 1)
    shine = np.clip(normals @ ((eye + light) / np.linalg.norm(eye + light)), 0, 1) ** 40
    brightness = openness * (0.36 + 0.62 * diffuse + 0.18 * np.clip(normals @ fill, 0, 1))
    colours = np.where((facing > 0)[:, None], BASE_COLOUR, INNER_COLOUR) * brightness[:, None]
    return np.clip(colours + 0.28 * (openness * shine)[:, None], 0.0, 1.0)


def _direction(elevation: float, azimuth: float) -> np.ndarray:
    up, around = math.radians(elevation), math.radians(azimuth)
    return np.array([math.cos(up) * math.cos(around), math.cos(up) * math.sin(around), math.sin(up)])


def _say_nothing_there(figure: Figure, place: tuple[float, float, float, float], field: SDM) -> None:
    values = field.numpy()
    if min(values.shape) < 2:
        why = "the grid is one voxel thin"
    elif not np.isfinite(values).any():
        why = "no distance is finite"
    else:
        why = f"no voxel is {'outside' if values[np.isfinite(values)].max() < 0 else 'inside'}"
    axes = figure.add_axes(place)
    axes.axis("off")
    axes.text(0.5, 0.5, f"no surface to draw:\n{why}", ha="center", va="center", fontsize=14, color="0.45")
