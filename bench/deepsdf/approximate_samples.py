"""DeepSDF's own recipe for ground truth, to compare exact samples with.

The nearest of millions of points that virtual cameras see gives the distance, the normals of the eleven nearest vote on
the sign, and samples whose vote is not unanimous are thrown away: J. Park et al., CVPR 2019, section 5, and the
preprocessing published with it (github.com/facebookresearch/DeepSDF at 48c19b8, src/PreprocessMesh.cpp), whose numbers
are the defaults here. There a display and a KD-tree on the host take minutes a shape; here cameras
(`_deepsdf_cameras`) and neighbours (`_deepsdf_nearest`) are found on the device, with the same answers.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.bench.common.timing import once
from sdm.bench.deepsdf.cameras import Cameras, seen_points
from sdm.bench.deepsdf.nearest import VOTES, Nearest
from sdm.deepsdf.samples import Samples, ShapeSet, surface_points
from sdm.io.files.torch_file import save_torch
from sdm.shapes.sampling import uniform

# What is further from the surface does not matter to the published training.
NEAR = 0.1
# A point of the surface is hidden if no camera sees anything within two pixels of the published images.
HIDDEN, ASKED = 0.01, 20_000


@dataclass(frozen=True)
class Quality:
    """Errors of the recipe's samples of a shape against exact values, where those are below `NEAR`.

    Args:
        seen_points: Points that the cameras see.
        hidden: Share of the surface that none sees.
        thrown_away: Share of the samples.
        wrong_signs: Share of those kept.
        mean_error, percentile95_error, worst_error: Of the distances kept, signs apart, in unit-sphere radii.
        mean_error_mm, percentile95_error_mm: In the mesh's unit.
        seconds: To look, to build the tree and to ask it.
    """

    seen_points: float
    hidden: float
    thrown_away: float
    wrong_signs: float
    mean_error: float
    percentile95_error: float
    worst_error: float
    mean_error_mm: float
    percentile95_error_mm: float
    seconds: float

    @classmethod
    def mean(cls, of: list[Quality]) -> Quality:
        """Column by column; the worst error is the worst of all."""
        columns = {f.name: [getattr(each, f.name) for each in of] for f in fields(cls)}
        means = {name: statistics.fmean(column) for name, column in columns.items()}
        return cls(**means | {"worst_error": max(columns["worst_error"])})


class ApproximateSamples:
    """A fixed table of samples for each shape, from which every step draws.

    Args:
        shapes: The shapes, which also give the exact values that the quality is judged by.
        samples: Of each shape, before some are thrown away.
        cameras: What looks at a shape.
        folder: Keeps each shape's table, so that preparing goes on where it was cut off; none are kept if not given.
    """

    def __init__(
        self, shapes: ShapeSet, samples: int = 500_000, cameras: Cameras | None = None, folder: Path | None = None
    ) -> None:
        cameras = cameras or Cameras()
        points, values, self.qualities = [], [], []
        for number, name in enumerate(shapes.names):
            about = {"name": name, "samples": samples, **asdict(cameras)}
            path = None if folder is None else folder / f"{number:04}.pt"
            saved = _read(path, about)
            if saved is None:
                at, found, quality = prepare(shapes, number, samples, cameras)
                saved = {"about": about, "points": at.cpu(), "values": found.cpu(), "quality": asdict(quality)}
                _keep(path, saved)
            # Tables of one length: what was thrown away is made up by repeating.
            rows = torch.arange(samples) % len(saved["values"])
            points.append(saved["points"][rows].to(shapes.device))
            values.append(saved["values"][rows].to(shapes.device))
            self.qualities.append(Quality(**saved["quality"]))
        self._points, self._values = torch.stack(points), torch.stack(values)

    def __len__(self) -> int:
        return len(self._points)

    def sample(self, shapes: Tensor, points: int, *, seed: int = 0, step: int = 0) -> Samples:
        """Rows of the tables, drawn anew in each step."""
        number = (step * len(self) + shapes)[:, None] * points + torch.arange(points, device=shapes.device)
        row = (uniform(seed, number.reshape(-1), 1)[:, 0] * self._values.shape[1]).long().reshape(len(shapes), points)
        return Samples(self._points[shapes[:, None], row], self._values[shapes[:, None], row])


def prepare(shapes: ShapeSet, number: int, samples: int, cameras: Cameras) -> tuple[Tensor, Tensor, Quality]:
    """Points (K,3) and values (K,) of a shape that are kept, and how good they are."""
    shape = torch.tensor([number], device=shapes.device)
    at, exact = (part[0] for part in shapes.sample(shape, samples, seed=1))
    mesh = shapes.mesh(number)

    def look_and_ask() -> tuple[Tensor, Nearest, tuple[Tensor, Tensor]]:
        surface, normals = seen_points(mesh, cameras)
        nearest = Nearest(surface)
        within = math.sqrt(max(shapes.distribution.variances))
        return surface, nearest, approximate(at, surface, normals, nearest, within)

    ms, (surface, nearest, (found, sure)) = once(look_and_ask, str(shapes.device))
    asked = surface_points(mesh, ASKED, seed=2)[0]
    away = (asked - surface[nearest(asked)[:, 0]]).norm(dim=1)
    near = sure & (exact.abs() < NEAR)
    error, radius = (found.abs() - exact.abs())[near].abs().double(), shapes.spheres[number].radius
    mean, high = float(error.mean()), float(_quantile(error, 0.95))
    return (
        at[sure],
        found[sure],
        Quality(
            seen_points=len(surface),
            hidden=float((away > HIDDEN).double().mean()),
            thrown_away=1 - float(sure.double().mean()),
            wrong_signs=float(((found < 0) != (exact < 0))[near].double().mean()),
            mean_error=mean,
            percentile95_error=high,
            worst_error=float(error.max()),
            mean_error_mm=mean * radius,
            percentile95_error_mm=high * radius,
            seconds=1e-3 * ms,
        ),
    )


def approximate(
    points: Tensor, surface: Tensor, normals: Tensor, nearest: Nearest, plane_within: float
) -> tuple[Tensor, Tensor]:
    """Signed distances (N,) of points (N,3) by the recipe, and which of them are kept (N,).

    Args:
        points: Where.
        surface: Dense points (M,3) of the surface.
        normals: Their normals (M,3).
        nearest: Finds the nearest of them.
        plane_within: Nearer than this the distance is that from the plane of the nearest point; the larger of the two
            deviations of samples as published.
    """
    closest = nearest(points)
    rays = points[:, None] - surface[closest]
    heights = (rays * normals[closest]).sum(2)
    distance = rays[:, 0].norm(dim=1)
    distance = torch.where(distance < plane_within, heights[:, 0].abs(), distance)
    outside = (heights > 0).sum(1)
    return torch.where(outside > VOTES // 2, distance, -distance), (outside == 0) | (outside == VOTES)


def _read(path: Path | None, about: dict[str, Any]) -> dict[str, Any] | None:
    """A table that was kept, if it is of the same shape and made in the same way."""
    if path is None or not path.exists():
        return None
    saved = torch.load(path, map_location="cpu")
    return saved if saved["about"] == about else None


def _keep(path: Path | None, saved: dict[str, Any]) -> None:
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_torch(saved, path)


def _quantile(values: Tensor, share: float) -> Tensor:
    # torch.quantile takes 16 million values at most; a sort takes any number.
    return values.sort().values[min(len(values) - 1, math.ceil(share * len(values)) - 1)]
