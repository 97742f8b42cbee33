"""Controls of a page, and what a scene shows for their values, without a browser."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM

# Of each control by its label: a slider's number, a choice's option, a switch's True or False.
Values = Mapping[str, float | str | bool]


@dataclass(frozen=True)
class Slider:
    """A number from `low` to `high`, in steps of `step`; `start` is where it stands at first."""

    label: str
    low: float
    high: float
    step: float
    start: float


@dataclass(frozen=True)
class Choice:
    """One of several options, the first at first."""

    label: str
    options: tuple[str, ...]

    @property
    def start(self) -> str:
        """The option at first."""
        return self.options[0]


@dataclass(frozen=True)
class Switch:
    """On or off."""

    label: str
    start: bool = False


Control = Slider | Choice | Switch


class Planes(Protocol):
    """A map of which only planes are computed, one when it is looked at."""

    grid: Grid

    def on_plane(self, axis: int, place: float) -> Float32[np.ndarray, "n m"]:
        """Values on the plane across an axis of the grid at a place in voxels, along the two axes that follow it."""
        ...


@dataclass(frozen=True)
class Shown:
    """A surface and a map to look at.

    Args:
        vertices: (V,3) float32, in the mesh's unit.
        faces: (F,3) int32, counter-clockwise from outside; none where there is no surface.
        field: The map that the plane cuts, or what computes planes of it.
        note: Lines of Markdown beside the controls.
        colours: (V,3) uint8, one for each vertex; None for the usual one.
        quantity: Name of the values that the plane cuts.
        scale_end: Value at the ends of the colour scale; None to choose it by the values.
        centre: Value in the middle of the colours, where the thick line is: 0 for distances, 0.5 for winding numbers.
        outline: Map whose zero is the thick line in place of that, on the same grid; then there are no other lines.
        grey: Shades of grey in place of colours, as for images.
    """

    vertices: Float32[np.ndarray, "v 3"]
    faces: Int32[np.ndarray, "f 3"]
    field: SDM | Planes
    note: str
    colours: UInt8[np.ndarray, "v 3"] | None = None
    quantity: str = "signed distance"
    scale_end: float | None = None
    centre: float = 0.0
    outline: SDM | None = None
    grey: bool = False


class Scene(Protocol):
    """A thing to explore: its controls, and what it shows for their values."""

    title: str

    @property
    def controls(self) -> Sequence[Control]:
        """In the order in which a page has them."""
        ...

    def show(self, values: Values) -> Shown:
        """The surface and map for the values of all controls."""
        ...


@runtime_checkable
class Moving(Protocol):
    """A scene that changes by itself: a stream, the steps of a fit. It has these methods besides."""

    def pause(self, values: Values) -> float | None:
        """Seconds from one step to the next; None while nothing moves."""
        ...

    def step(self, values: Values) -> bool:
        """One step further; True if there is something new to show."""
        ...

    def close(self) -> None:
        """End what works in the background, once the page is gone."""
        ...


def start_values(scene: Scene) -> dict[str, float | str | bool]:
    """The values that the controls have at first."""
    return {control.label: control.start for control in scene.controls}
