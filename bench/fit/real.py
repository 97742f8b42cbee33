"""The mean human scala tympani as a case: mesh to image to fit, and what the family cannot explain of it.

The family's constants were tuned to this same mean shape (bench/fit/cochlea_family.py), so the residual says how well
four parameters and a pose describe it through a scanner, not how well they describe other people's.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch

from sdm import Grid, MeshIndex, SDMError, TriangleMesh, load_mesh
from sdm.bench.common.checkout import data_folder
from sdm.bench.common.json_file import write
from sdm.bench.common.machine import describe
from sdm.bench.fit.tools import backends_by_name, fit_case
from sdm.fit import SCANNERS, FitResult, Image, Scanner
from sdm.fit.model.backend import Distances
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State
from sdm.fit.study.simulate import FINE, SHARP
from sdm.viz.fit_figure import surface_of

# The mean shape is an average in a frame of its own: its base points along -x, so it is turned by this about z [rad],
# as bench/fit/cochlea_family.py found, to be roughly the way the family is.
TURN = -1.1
MARGIN = 1.5


class _OneMesh:
    """A backend of one mesh without parameters, to render it."""

    name, parameters, slack, evaluations = "mesh", (), 1e-4, 0
    device = torch.device("cpu")
    centre = torch.zeros(3, dtype=torch.float64)

    def __init__(self, mesh: TriangleMesh) -> None:
        self._index = MeshIndex(mesh, "cpu")

    def distances(self, theta: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
        """Signed distances (N,) float64 of points (N,3)."""
        return self._index.signed_distance(points.float()).double()

    def with_derivatives(self, theta: torch.Tensor, points: torch.Tensor) -> Distances:
        """There is nothing to differentiate by."""
        raise NotImplementedError


def real_mesh(data: Path | None) -> TriangleMesh:
    """The mean scala tympani, turned roughly into the family's frame.

    Raises:
        SDMError: The data are not there.
    """
    folder = data_folder() if data is None else data
    path = folder / "scala_tympani" / "scala_tympani_mean.ply"
    if not path.is_file():
        raise SDMError(f"there is no {path}: name the folder of test data with --data or SDM_DATA")
    mesh = load_mesh(path)
    cosine, sine = np.cos(-TURN), np.sin(-TURN)
    turn = torch.tensor([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float32)
    return TriangleMesh(mesh.vertices @ turn.T, mesh.faces, mesh.name)


def scan(mesh: TriangleMesh, scanner: Scanner, seed: int) -> Image:
    """A CT-like image of a mesh."""
    low, high = (np.asarray(end, dtype=np.float64) for end in mesh.bounds)
    shape = np.ceil((high - low + 2 * MARGIN) / scanner.spacing).astype(int)
    grid = Grid((low + high) / 2 - scanner.spacing * (shape - 1) / 2, (scanner.spacing,) * 3, shape)
    nowhere = torch.zeros(3, dtype=torch.float64)
    state = State(torch.zeros(0, dtype=torch.float64), torch.eye(3, dtype=torch.float64), nowhere, nowhere)
    share = Renderer(grid, _OneMesh(mesh), blur=scanner.blur, length=FINE / SHARP, fine=FINE)(state, derivatives=False)
    noise = torch.from_numpy(np.random.Generator(np.random.Philox(seed)).standard_normal(grid.shape))
    values = scanner.outside + (scanner.inside - scanner.outside) * share.share + scanner.noise * noise
    return Image(values.float(), grid)


def real(options: argparse.Namespace) -> None:
    """Fit both scanners' images of the real shape; print and write the residuals."""
    mesh = real_mesh(options.data)
    found: dict[str, Any] = {}
    for scanner, made in SCANNERS.items():
        backends = backends_by_name(options.backend, options.device, options.weights)
        result = fit_case(scan(mesh, made, seed=7), scanner, backends)
        found[scanner] = result.record() | {"residual": residual(mesh, result, backends[1] or backends[0])}
        found[scanner].pop("covariance")
        theta = {name: round(value["estimate"], 4) for name, value in found[scanner]["theta"].items()}
        print(scanner, "mm", theta, found[scanner]["residual"], "trusted", result.trusted, result.diagnosis.problems)
    write(options.out, {"scanners": found, "machine": describe(options.device)})


def residual(mesh: TriangleMesh, result: FitResult, backend: Any) -> dict[str, float]:
    """Distances between the fitted and the real surface [mm], vertex to surface, both ways."""
    own = surface_of(backend, result)
    there = MeshIndex(mesh, "cpu").signed_distance(own.vertices).abs()
    back = MeshIndex(own, "cpu").signed_distance(mesh.vertices).abs()
    both = torch.cat([there, back])
    return {
        "mean_mm": round(float((there.mean() + back.mean()) / 2), 4),
        "95_percent_mm": round(float(both.quantile(0.95)), 4),
        "largest_mm": round(float(both.max()), 4),
        "dice": round(dice(mesh, own), 4),
    }


def dice(mesh: TriangleMesh, other: TriangleMesh, spacing: float = 0.1) -> float:
    """Overlap of two shapes, on voxels of `spacing` [mm]."""
    low = torch.minimum(mesh.vertices.amin(0), other.vertices.amin(0)) - spacing
    high = torch.maximum(mesh.vertices.amax(0), other.vertices.amax(0)) + spacing
    grid = Grid(low.tolist(), (spacing,) * 3, ((high - low) / spacing).ceil().int().tolist())
    one, two = (MeshIndex(m, "cpu").signed_distance_map(grid).values < 0 for m in (mesh, other))
    return 2 * float((one & two).sum()) / float(one.sum() + two.sum())
