"""The layout of Occupancy Networks (L. Mescheder et al., CVPR 2019), whose loader reads it unchanged.

In `CLASS/INSTANCE/`: `points.npz` with `points` (N,3) float16, `occupancies` (one bit a point), `loc` and `scale`; and
`pointcloud.npz` with points of the surface and their `normals`, both float16. A point p of the mesh is
(p - loc) / scale there: its cube has the edge 1. What is inside is measured at the rounded points.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from torch import Tensor

from sdm.core.normalization import Normal, Normalization
from sdm.io.files.atomic import put
from sdm.sampling.law import OCCUPANCY, SURFACE, SampleLaw
from sdm.sampling.layouts.instance import Instance, lists_of
from sdm.sampling.layouts.npz_file import write_npz
from sdm.sampling.sample import PointSamples

# Edge of the cube that meshes are normalised to here, in that of the layout.
EDGE = 2.0


class OccupancyLayout:
    """See above."""

    # Half of the samples are points of the surface.
    law: SampleLaw = SampleLaw(near=0, uniform=1, surface=1, deviations=(), box=OCCUPANCY.box)
    normalize: Normal = "cube"
    count, with_normals, together = 200_000, True, 1

    def begin(self, folder: Path, instances: list[Instance], count: int) -> None:
        """See `Layout`."""
        self._folder, self._instances = folder, instances

    def is_done(self, number: int) -> bool:
        """See `Layout`. The points are written last."""
        return (self._place(number) / "points.npz").is_file()

    def write(self, number: int, samples: PointSamples) -> Path:
        """See `Layout`."""
        by = samples.normalization or Normalization("cube", (0.0, 0.0, 0.0), 1.0)
        where = {"loc": np.asarray(by.centre, np.float64), "scale": np.float64(EDGE * by.length)}
        points = (samples.points / EDGE).half().cpu().numpy()
        on = (samples.kinds == SURFACE).cpu().numpy()
        place = self._place(number)
        if samples.normals is not None and on.any():
            normals = samples.normals.half().cpu().numpy()
            write_npz(place / "pointcloud.npz", points=points[on], normals=normals[on], **where)
        bits = np.packbits(samples.occupancies.cpu().numpy()[~on])
        write_npz(place / "points.npz", points=points[~on], occupancies=bits, **where)
        return place / "points.npz"

    def failed(self, number: int) -> None:
        """See `Layout`."""

    def rounded(self, points: Tensor) -> Tensor:
        """See `Layout`: in half precision."""
        return (points / EDGE).half().float() * EDGE

    def end(self, done: list[bool], parts: dict[str, list[int]]) -> None:
        """See `Layout`."""
        for part, classes in lists_of(self._instances, done, parts).items():
            for category, names in classes.items():
                # That loader splits at newlines: one at the end would be a mesh without a name.
                put(self._folder / category / f"{part}.lst", "\n".join(names).encode())

    def _place(self, number: int) -> Path:
        instance = self._instances[number]
        return self._folder / instance.category / instance.name
