"""Shapes between two codes of a DeepSDF model: the straight line from one to the other by a slider."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from sdm.core.grid import Grid
from sdm.deepsdf import DeepSDF, decode_near_surface
from sdm.deepsdf.samples import UnitSphere
from sdm.errors import SDMError
from sdm.explore.controls import Control, Shown, Slider, Values
from sdm.explore.planes import ComputedPlanes

FIRST, LAST, BETWEEN = "from shape", "to shape", "between"
# Fewer voxels have no tiles from coarse to fine.
FEWEST = 16


class CodesScene:
    """The shapes that a DeepSDF model was trained on, and those between them.

    Args:
        title: Its name.
        model: With at least two shapes.
        resolution: Voxels along each axis, at least 16.

    Only what is near the surface is decoded, and the plane that is shown.
    """

    def __init__(self, title: str, model: DeepSDF, resolution: int) -> None:
        if len(model.names) < 2:
            raise SDMError(
                f"{title} has the code of {len(model.names)} shape; two are needed to go from one to another"
            )
        if resolution < FEWEST:
            raise SDMError(f"--resolution is {resolution}; a DeepSDF model needs at least {FEWEST}")
        self.title, self.model, self.resolution = title, model, resolution
        last = len(model.names) - 1
        self.controls: Sequence[Control] = (
            Slider(FIRST, 0, last, 1, 0),
            Slider(LAST, 0, last, 1, 1),
            Slider(BETWEEN, 0.0, 1.0, 0.01, 0.5),
        )

    def show(self, values: Values) -> Shown:
        """The shape at a share of the way, and the learned distances from it."""
        a, b, share = int(values[FIRST]), int(values[LAST]), float(values[BETWEEN])
        code = torch.lerp(self.model.codes[a], self.model.codes[b], share)
        sphere = _between(self.model.spheres[a], self.model.spheres[b], share)
        names = f"{self.model.names[a]} to {self.model.names[b]}, {share:.0%} of the way"
        size = 2 * sphere.radius / (self.resolution - 1)
        grid = Grid([c - sphere.radius for c in sphere.centre], (size,) * 3, (self.resolution,) * 3)
        planes = ComputedPlanes(grid, lambda layer: self.model.signed_distance_map(layer, code, sphere))
        near = decode_near_surface(self.model, code, sphere=sphere, resolution=self.resolution)
        surface = near.to_mesh()
        note = f"{names}; learned distances, {self.resolution}³ voxels, {len(surface.faces):,} triangles"
        return Shown(surface.vertices.cpu().numpy(), surface.faces.cpu().numpy(), planes, note)


def _between(first: UnitSphere, last: UnitSphere, share: float) -> UnitSphere:
    x, y, z, radius = (
        (1 - share) * a + share * b
        for a, b in zip((*first.centre, first.radius), (*last.centre, last.radius), strict=True)
    )
    return UnitSphere((x, y, z), radius)
