"""A map, a narrow band or a dataset's maps, by the surface at a distance that a slider says."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sdm.core.signed_distance_map import SDM
from sdm.errors import SDMError
from sdm.explore.controls import Control, Shown, Slider, Values

LEVEL, SAMPLE = "surface at distance", "sample"


class MapScene:
    """Maps by number.

    Args:
        title: Its name.
        read: The map of a number, on the host.
        count: How many there are.
    """

    def __init__(self, title: str, read: Callable[[int], SDM], count: int = 1) -> None:
        self.title, self._read = title, read
        self._known: tuple[int, SDM] = (0, read(0))
        low, high = _range(self._known[1])
        if not low < high:
            raise SDMError(f"{title} has the same value everywhere, so there is no surface to show")
        start = 0.0 if low <= 0 <= high else (low + high) / 2
        controls: list[Control] = [Slider(LEVEL, low, high, (high - low) / 400, start)]
        if count > 1:
            controls.insert(0, Slider(SAMPLE, 0, count - 1, 1, 0))
        self.controls = controls

    def show(self, values: Values) -> Shown:
        """The surface of one map at one distance; none where no voxel's edge crosses it."""
        number = int(values.get(SAMPLE, 0))
        if number != self._known[0]:
            self._known = (number, self._read(number))
        field = self._known[1]
        level = float(values.get(LEVEL, 0.0))
        size = "×".join(map(str, field.grid.shape))
        try:
            surface = field.to_mesh(level)
        except SDMError as error:
            return Shown(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), field, str(error))
        note = f"{size} voxels, {len(surface.faces):,} triangles where the distance is {level:.3g}"
        return Shown(surface.vertices.numpy(), surface.faces.numpy(), field, note)


def _range(field: SDM) -> tuple[float, float]:
    values = field.numpy()
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
