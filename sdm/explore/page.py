"""A page that viser shows: a scene's controls, its surface, and the plane that cuts it."""

from __future__ import annotations

import base64
import io
import time
from typing import Any

import numpy as np

from sdm.explore.colour_bar import colour_bar
from sdm.explore.controls import Choice, Control, Moving, Scene, Shown, Slider, start_values
from sdm.explore.cutting_plane import AXES, Cut, cut, cut_away, place_of, scale_of
from sdm.explore.newest_values import NewestValues
from sdm.viz.figure import line_step

PLANE, PLACE, ACROSS, OPEN = "show the plane", "place", "across", "hide what is before it"
# What the arrow on the plane says, which is no control: a point (3,) that the plane is to go through.
DRAGGED = "the plane's arrow"
SURFACE_COLOUR = (222, 203, 176)
# The last on grey.
LINE_COLOUR, MIDDLE_COLOUR, OUTLINE_COLOUR = (70, 70, 70), (0, 0, 0), (224, 160, 16)
# Pixels.
LINE, MIDDLE_LINE = 1.0, 3.0
# The scene's radius is at least this share of the map's.
SMALLEST = 0.55
# Length of the arrow, as a share of the plane's longer edge.
ARROW = 0.25
# Seconds between looks for somebody who looks, where a scene moves by itself.
NOBODY = 0.25
# The camera looks from this direction, and from so many radii of the scene.
EYE, RADII = np.array([0.5, -0.95, 0.5]), 2.3


class Page:
    """One scene on a server of viser's.

    Args:
        server: A `viser.ViserServer`.
        scene: What to show.
        newest: Where the values of controls are put; `draw` takes them.
        unit: Of lengths, for the colour bar; "" if not known.
    """

    def __init__(self, server: Any, scene: Scene, newest: NewestValues, unit: str = "") -> None:
        self.server, self.scene, self.newest, self.unit = server, scene, newest, unit
        self.values: dict[str, Any] = start_values(scene)
        self.plane: dict[str, Any] = {PLANE: True, ACROSS: "y", PLACE: 0.5, OPEN: False}
        self.drawn = 0
        self._handles: dict[str, Any] = {}
        self._shown: Shown | None = None
        self._scale: tuple[str, float] | None = None
        self._turned: tuple[np.ndarray, np.ndarray] | None = None
        self._stepped = time.monotonic()
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        server.gui.add_markdown(f"### {scene.title}")
        for control in scene.controls:
            self._add(control)
        with server.gui.add_folder("plane"):
            self._listen(PLANE, server.gui.add_checkbox(PLANE, True))
            self._listen(ACROSS, server.gui.add_dropdown(ACROSS, AXES, initial_value="y"))
            self._place = server.gui.add_slider(PLACE, 0.0, 1.0, 0.005, 0.5)
            self._listen(PLACE, self._place)
            self._listen(OPEN, server.gui.add_checkbox(OPEN, False))
            self._shown = scene.show(self.values)
            self._bar_picture = self._colour_bar(self._shown)
            self._bar = server.gui.add_html(_as_html(self._bar_picture))
        self._note = server.gui.add_markdown("")
        self.draw({})
        self._look()

    def draw(self, changed: dict[str, Any]) -> None:
        """Draw what the newest values say."""
        point = changed.pop(DRAGGED, None)
        for name, value in changed.items():
            (self.plane if name in self.plane else self.values)[name] = value
        if point is not None:
            assert self._shown is not None  # noqa: S101  drawn in the constructor
            self.plane[PLACE] = place_of(self._shown.field.grid, self.plane[ACROSS], point)
            self._place.value = round(self.plane[PLACE], 3)
        if self._shown is None or any(name in self.values for name in changed):
            self._shown = self.scene.show(self.values)
        shown = self._shown
        plane = cut(shown, self.plane[ACROSS], self.plane[PLACE], self._limit(shown))
        with self.server.atomic():
            self._draw_surface(shown, plane)
            self._draw_plane(plane, dragged=point is not None, grey=shown.grey)
            self._note.content = shown.note
        picture = self._colour_bar(shown)
        if picture is not self._bar_picture:
            self._bar_picture = picture
            self._bar.content = _as_html(picture)
        self.drawn += 1

    def until_step(self) -> float | None:
        """Seconds until the scene is to go a step further; None if it does not move."""
        pause = self.scene.pause(self.values) if isinstance(self.scene, Moving) else None
        if pause is None:
            return None
        return max(self._stepped + pause - time.monotonic(), 0.0) if self.server.get_clients() else NOBODY

    def step(self) -> None:
        """Let a scene that moves go a step further, and draw it if there is something new, where somebody looks."""
        if not isinstance(self.scene, Moving) or not self.server.get_clients():
            return
        pause = self.scene.pause(self.values)
        if pause is None or time.monotonic() < self._stepped + pause:
            return
        self._stepped = time.monotonic()
        if self.scene.step(self.values):
            self._shown = self.scene.show(self.values)
            self.draw({})

    def _add(self, control: Control) -> None:
        gui = self.server.gui
        if isinstance(control, Slider):
            handle = gui.add_slider(control.label, control.low, control.high, control.step, control.start)
        elif isinstance(control, Choice):
            handle = gui.add_dropdown(control.label, control.options, initial_value=control.start)
        else:
            handle = gui.add_checkbox(control.label, control.start)
        self._listen(control.label, handle)

    def _listen(self, name: str, handle: Any) -> None:
        # A coroutine runs on the server's own thread; a plain function would run on one of a pool.
        async def put(event: Any) -> None:
            self.newest.put(name, event.target.value)

        handle.on_update(put)

    def _limit(self, shown: Shown) -> float:
        """The end of the colour scale, which stays while values of one kind change, so that colours can be compared."""
        if shown.scale_end is not None:
            return shown.scale_end
        if self._scale is None or self._scale[0] != shown.quantity:
            self._scale = (shown.quantity, scale_of(shown.field))
        return self._scale[1]

    def _colour_bar(self, shown: Shown) -> np.ndarray:
        limit = self._limit(shown)
        unit = self.unit if shown.scale_end is None else ""
        step = None if shown.outline is not None else line_step(limit)
        return colour_bar(limit, shown.centre, step, shown.quantity, unit, shown.grey)

    def _draw_surface(self, shown: Shown, plane: Cut) -> None:
        faces = shown.faces
        if self.plane[PLANE] and self.plane[OPEN]:
            faces = cut_away(shown.vertices, faces, plane)
        handle = self._handles.get("surface")
        if shown.colours is None and handle is not None and len(faces) and hasattr(handle, "vertices"):
            # Indices must never point beyond the vertices that are there, between the two.
            handle.vertices = shown.vertices
            if not np.array_equal(handle.faces, faces):
                handle.faces = faces.astype(np.uint32)
            return
        if handle is not None:
            handle.remove()
            self._handles.pop("surface")
        if not len(faces):
            return
        if shown.colours is None:
            self._handles["surface"] = self.server.scene.add_mesh_simple(
                "/surface", shown.vertices, faces.astype(np.uint32), color=SURFACE_COLOUR, side="double"
            )
            return
        import trimesh

        mesh = trimesh.Trimesh(shown.vertices, faces, vertex_colors=shown.colours, process=False)
        self._handles["surface"] = self.server.scene.add_mesh_trimesh("/surface", mesh)

    def _draw_plane(self, plane: Cut, *, dragged: bool, grey: bool) -> None:
        scene = self.server.scene
        visible = bool(self.plane[PLANE])
        for name in ("lines", "middle") if visible else ("plane", "arrow", "lines", "middle"):
            handle = self._handles.pop(name, None)
            if handle is not None:
                handle.remove()
        if not visible:
            return
        if self._turned is None or not np.array_equal(self._turned[0], plane.rotation):
            self._turned = plane.rotation, _quaternion(plane.rotation)
        pose = {"wxyz": self._turned[1], "position": plane.position}
        self._draw_picture(plane, pose)
        if "arrow" not in self._handles:
            arrow = scene.add_transform_controls(
                "/arrow",
                scale=ARROW * max(plane.size),
                active_axes=(False, False, True),
                disable_sliders=True,
                disable_rotations=True,
                # Seen also where it begins inside the surface.
                depth_test=False,
                **pose,
            )
            self._handles["arrow"] = arrow

            async def put(event: Any) -> None:
                self.newest.put(DRAGGED, np.asarray(event.target.position))

            arrow.on_update(put)
        elif not dragged:
            _place(self._handles["arrow"], pose)
        # A hair before the plane, on the side that is looked at.
        lift = (1e-3 * max(plane.size) * plane.rotation[:, 2]).astype(np.float32)
        for name, lines, colour, thickness in (
            ("lines", plane.lines, LINE_COLOUR, LINE),
            ("middle", plane.middle, OUTLINE_COLOUR if grey else MIDDLE_COLOUR, MIDDLE_LINE),
        ):
            if len(lines):
                self._handles[name] = scene.add_line_segments(
                    f"/{name}", lines + lift, np.array(colour, np.uint8), thickness=thickness, thickness_units="screen"
                )

    def _draw_picture(self, plane: Cut, pose: dict[str, Any]) -> None:
        handle = self._handles.get("plane")
        if handle is not None and (handle.render_width, handle.render_height) == plane.size:
            handle.image = plane.image
            _place(handle, pose)
            return
        if handle is not None:
            handle.remove()
        self._handles["plane"] = self.server.scene.add_image(
            "/plane",
            plane.image,
            *plane.size,
            format="jpeg",
            jpeg_quality=90,
            cast_shadow=False,
            receive_shadow=False,
            **pose,
        )

    def _look(self) -> None:
        """Place the camera so that the surface, or else the map, fills the page."""
        assert self._shown is not None  # noqa: S101  drawn in the constructor
        grid, points = self._shown.field.grid, self._shown.vertices
        corners = (grid.affine[:3, :3] @ np.diag(np.subtract(grid.shape, 1))).T + grid.affine[:3, 3]
        if not len(points):
            points = corners
        low, high = points.min(0), points.max(0)
        # Shapes of other parameters may be larger.
        least = SMALLEST * float(np.linalg.norm(corners.max(0) - corners.min(0)))
        middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)), least) / 2
        camera = self.server.initial_camera
        camera.look_at = tuple(map(float, middle))
        # The plane's normal side is cut away: that is where to look from.
        eye = np.abs(EYE) if self.plane[ACROSS] != "y" else EYE * [1, -1, 1]
        camera.position = tuple(map(float, middle + RADII * radius * eye / np.linalg.norm(eye)))
        camera.up = (0.0, 0.0, 1.0)
        camera.near, camera.far = radius / 100, radius * 100


def _place(handle: Any, pose: dict[str, Any]) -> None:
    """Turn and move what is drawn; to set what it has already would cost as much."""
    for name, value in pose.items():
        if not np.array_equal(getattr(handle, name), value):
            setattr(handle, name, value)


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """(w,x,y,z) of a rotation matrix."""
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(rotation).as_quat(), 1)


def _as_html(picture: np.ndarray) -> str:
    """An element that holds a picture itself: of viser's own image elements browsers may lose the blob as they load."""
    from PIL import Image

    with io.BytesIO() as file:
        Image.fromarray(picture).save(file, "png")
        content = base64.b64encode(file.getvalue()).decode()
    return f'<img alt="colour bar" style="width: 100%" src="data:image/png;base64,{content}">'
