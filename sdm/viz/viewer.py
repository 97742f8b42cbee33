"""Viewer of a map from all sides: its surface, and a slice that the mouse moves. By Polyscope, an extra."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError, SDMError
from sdm.io.files.atomic import replacing
from sdm.viz.figure import colour_limit, line_step
from sdm.viz.style import MAP_COLOURS, colour_map

PIXELS = (1600, 1000)
# Samples of a pixel, along each axis.
SAMPLES = 3
# Polyscope's, in degrees from the lower edge of a picture to the upper one, and the room that is left around.
VIEW_ANGLE, ROOM = 45.0, 1.1
PALETTE = "inside red, outside blue"


def view(field: SDM, *, mesh: MeshLike | None = None, level: float = 0.0, picture: str | Path | None = None) -> None:
    """Show a map in a window until it is closed, or draw what the window would show.

    The surface where the distance is `level` stands out of the map, which is cut through its middle; on the cut are
    lines of equal distance. In the window the cut is moved and turned by its handles, and a slider moves the level.

    Args:
        field: The map.
        mesh: Its mesh, or whatever `as_mesh` takes for one, shown in place of the map's surface at level 0.
        level: In the map's unit.
        picture: A .png to write in place of opening a window; that takes OpenGL, but no display.

    Raises:
        SDMError: Polyscope is not installed, there is nowhere to open a window, no voxel edge crosses the level, or the
            grid is one voxel thin.
        FormatError: The picture's name does not end in .png, or it cannot be written.
    """
    check_view(picture)
    surface = as_mesh(mesh) if mesh is not None and level == 0.0 else field.to_mesh(level)
    polyscope = _started(window=picture is None)
    cut = _show_map(polyscope, field)
    _show_surface(polyscope, surface, cut)
    _look(polyscope, field, surface)
    if picture is not None:
        _draw(polyscope, Path(picture))
        return
    polyscope.set_user_callback(_slider(polyscope, field, cut, level))
    polyscope.show()
    polyscope.clear_user_callback()


def check_view(picture: str | Path | None = None) -> None:
    """Refuse a view that cannot be shown, or a picture of it that cannot be one, before a map is made for it.

    Raises:
        SDMError: Polyscope is not installed, or there is nowhere to open a window.
        FormatError: The picture's name does not end in .png.
    """
    if picture is not None and Path(picture).suffix.lower() != ".png":
        raise FormatError(f"{picture} does not end in .png, the one kind of picture that a view can be")
    if find_spec("polyscope") is None:
        raise SDMError("a view needs Polyscope, which is not installed: pip install '.[viewer]' in a clone")
    if picture is None and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise SDMError("there is no display to open a window on: draw a picture (sdm view --out FILE.png)")


def _started(*, window: bool) -> Any:
    """Polyscope, with nothing to show yet."""
    polyscope: Any = import_module("polyscope")
    polyscope.set_verbosity(0)
    polyscope.set_program_name("sdm view")
    # Else it reads and writes a file in whatever folder this is.
    polyscope.set_use_prefs_file(False)
    polyscope.set_allow_headless_backends(not window)
    try:
        polyscope.init()
    except RuntimeError:
        raise SDMError("OpenGL cannot be used here: look at sdm.viz.figure's figures, which need none") from None
    polyscope.remove_all_structures()
    polyscope.remove_all_slice_planes()
    polyscope.set_up_dir("z_up")
    polyscope.set_ground_plane_mode("none")
    polyscope.set_window_size(*PIXELS)
    polyscope.set_SSAA_factor(SAMPLES)
    return polyscope


def _show_map(polyscope: Any, field: SDM) -> Any:
    """The map as a block, cut through the middle across its second axis; returns the cut."""
    grid = field.grid
    far = np.multiply(grid.spacing, np.subtract(grid.shape, 1))
    shown = polyscope.register_volume_grid("map", grid.shape, (0.0, 0.0, 0.0), far)
    place = np.eye(4)
    place[:3, :3] = grid.direction
    place[:3, 3] = grid.origin
    shown.set_transform(place)
    values = field.numpy()
    limit, _ = colour_limit(values)
    shown.add_scalar_quantity(
        "signed distance",
        np.nan_to_num(values, nan=limit, posinf=limit, neginf=-limit),
        enabled=True,
        cmap=_palette(polyscope),
        vminmax=(-limit, limit),
        isolines_enabled=True,
        isoline_period=line_step(limit),
        isoline_period_relative=False,
    )
    cut = polyscope.add_scene_slice_plane()
    cut.set_pose(_middle(field), place[:3, 1])
    cut.set_draw_plane(False)
    cut.set_draw_widget(True)
    return cut


def _show_surface(polyscope: Any, surface: TriangleMesh, cut: Any) -> None:
    shown = polyscope.register_surface_mesh("surface", surface.vertices.cpu().numpy(), surface.faces.cpu().numpy())
    shown.set_color(_rgb(MAP_COLOURS[1]))
    shown.set_smooth_shade(True)
    # The cut goes through the map alone.
    shown.set_ignore_slice_plane(cut, True)


def _look(polyscope: Any, field: SDM, surface: TriangleMesh) -> None:
    """From the side that is cut away, and a little from above, so far away that all that is shown is seen."""
    middle = _middle(field)
    towards = np.array(field.grid.direction) @ np.array([0.35, -1.0, 0.45])
    towards /= np.linalg.norm(towards)
    # The half of the map behind the cut.
    ends = np.array(field.grid.shape) - 1.0
    behind = np.array(list(product((0.0, ends[0]), (ends[1] / 2, ends[1]), (0.0, ends[2]))))
    affine = field.grid.affine
    shown = np.concatenate([behind @ affine[:3, :3].T + affine[:3, 3], surface.numpy()[0]])
    polyscope.look_at(middle + distance_to_see(shown - middle, towards) * towards, middle)


def distance_to_see(places: np.ndarray, towards: np.ndarray) -> float:
    """Distance of a camera, along `towards` (3,) from the origin that it looks at, from which all places are seen.

    Args:
        places: (N,3).
        towards: A unit vector. Up in the picture is z.
    """
    right = np.cross([0.0, 0.0, 1.0], towards)
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    above, slope = np.cross(towards, right), np.tan(np.radians(VIEW_ANGLE / 2)) / ROOM
    sideways, upwards = np.abs(places @ right) * PIXELS[1] / PIXELS[0], np.abs(places @ above)
    return float((places @ towards + np.maximum(sideways, upwards) / slope).max())


def _middle(field: SDM) -> np.ndarray:
    affine = field.grid.affine
    return affine[:3, :3] @ ((np.array(field.grid.shape) - 1) / 2) + affine[:3, 3]


def _palette(polyscope: Any) -> str:
    """The colours of `sdm.viz.style`, which Polyscope reads from an image."""
    from matplotlib.image import imsave

    row = colour_map()(np.linspace(0, 1, 256))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "palette.png"
        imsave(path, np.repeat(row[None], 4, 0))
        polyscope.load_color_map(PALETTE, str(path))
    return PALETTE


def _rgb(colour: str) -> tuple[float, float, float]:
    from matplotlib.colors import to_rgb

    return to_rgb(colour)


def _draw(polyscope: Any, path: Path) -> None:
    pixels = polyscope.screenshot_to_buffer(transparent_bg=False)
    from matplotlib.image import imsave

    with replacing(path) as part:
        imsave(part, np.ascontiguousarray(pixels[..., :3]), format="png")


def _slider(polyscope: Any, field: SDM, cut: Any, level: float) -> Callable[[], None]:
    """A callback that draws the slider, once a frame."""
    gui: Any = import_module("polyscope.imgui")
    values = field.numpy()
    low, high = float(values.min()), float(values.max())
    now = level

    def draw() -> None:
        nonlocal now
        moved, wanted = gui.SliderFloat("level", now, low, high)
        if moved and low < wanted < high:
            now = wanted
            _show_surface(polyscope, field.to_mesh(now), cut)

    return draw
