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
from sdm.fit import SCANNERS, FitOptions, Image, Scanner, fit_shape
from sdm.fit.model.backend import Distances
from sdm.fit.model.partial_volume import Renderer
from sdm.fit.model.pose import State
from sdm.fit.solve.free_form import free_form
from sdm.fit.study.simulate import FINE, SHARP
from sdm.inspect import orient_outward
from sdm.viz.fit_figure import surface_of

# The mean shape is an average in a frame of its own: its base points along -x, so it is turned by this about z [rad],
# as bench/fit/cochlea_family.py found, to be roughly the way the family is.
TURN = -1.1
MARGIN = 1.5
# The duct beside it: the rings, so much smaller, above their own with so much bone between them [mm].
DUCT, BONE = 0.6, 0.2


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
    return _turned(load_mesh(path))


def duct_mesh(data: Path | None) -> TriangleMesh:
    """A duct above the mean scala tympani in `real_mesh`'s frame, as the scala vestibuli is: a tube of its rings.

    No data of that scala are here. Its rings are the tympani's, 0.6 times as large, moved along z until 0.2 mm of bone
    are between the two.
    """
    folder = data_folder() if data is None else data
    rings = np.load(folder / "scala_tympani" / "rings.npy").astype(np.float64)
    middle, height = rings.mean(1, keepdims=True), np.ptp(rings[..., 2], axis=1)
    rings = middle + DUCT * (rings - middle)
    rings[..., 2] += ((1 + DUCT) * height / 2 + BONE)[:, None]
    count, around = rings.shape[:2]
    one, two = np.arange(around), (np.arange(around) + 1) % around
    base = np.arange(count - 1)[:, None] * around
    quads = [base + one, base + around + one, base + around + two, base + two]
    a, b, c, d = (quad.ravel() for quad in quads)
    ends = [np.stack([np.full(around, count * around + k), at + one, at + two][:: 1 if k else -1], 1)
            for k, at in ((0, 0), (1, (count - 1) * around))]  # fmt: skip
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1), *ends]).astype(np.int32)
    vertices = np.concatenate([rings.reshape(-1, 3), rings[0].mean(0)[None], rings[-1].mean(0)[None]])
    mesh = TriangleMesh(vertices.astype(np.float32), faces, "duct")
    return orient_outward(_turned(mesh))


def _turned(mesh: TriangleMesh) -> TriangleMesh:
    cosine, sine = np.cos(-TURN), np.sin(-TURN)
    turn = torch.tensor([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float32)
    return TriangleMesh(mesh.vertices @ turn.T, mesh.faces, mesh.name)


def scan(mesh: TriangleMesh, scanner: Scanner, seed: int, beside: TriangleMesh | None = None) -> Image:
    """A CT-like image of a mesh, on a grid around it, and of another that is filled as it is."""
    low, high = (np.asarray(end, dtype=np.float64) for end in mesh.bounds)
    shape = np.ceil((high - low + 2 * MARGIN) / scanner.spacing).astype(int)
    grid = Grid((low + high) / 2 - scanner.spacing * (shape - 1) / 2, (scanner.spacing,) * 3, shape)
    nowhere = torch.zeros(3, dtype=torch.float64)
    state = State(torch.zeros(0, dtype=torch.float64), torch.eye(3, dtype=torch.float64), nowhere, nowhere)
    share = sum(
        Renderer(grid, _OneMesh(each), blur=scanner.blur, length=FINE / SHARP, fine=FINE)(
            state, derivatives=False
        ).share
        for each in ((mesh,) if beside is None else (mesh, beside))
    )
    noise = torch.from_numpy(np.random.Generator(np.random.Philox(seed)).standard_normal(grid.shape))
    values = scanner.outside + (scanner.inside - scanner.outside) * share + scanner.noise * noise
    return Image(values.float(), grid)


def real(options: argparse.Namespace) -> None:
    """Fit both scanners' images of the real shape; print and write the residuals."""
    mesh = real_mesh(options.data)
    found: dict[str, Any] = {}
    for scanner, made in SCANNERS.items():
        backends = backends_by_name(options.backend, options.device, options.weights)
        image = scan(mesh, made, seed=7)
        result = fit_case(image, scanner, backends)
        fitted = surface_of(backends[1] or backends[0], result)
        free = free_form(image.values, image.grid, fitted, blur=made.blur, device=options.device)
        found[scanner] = result.record() | {"residual": residual(mesh, fitted)}
        found[scanner]["residual_free_form"] = residual(mesh, free.mesh)
        found[scanner].pop("covariance")
        theta = {name: round(value["estimate"], 4) for name, value in found[scanner]["theta"].items()}
        print(
            scanner,
            "mm",
            theta,
            found[scanner]["residual"],
            found[scanner]["residual_free_form"],
            "trusted",
            result.trusted,
            result.diagnosis.problems,
        )
    beside = with_duct(mesh, options)
    write(options.out, {"scanners": found, "with_duct": beside, "machine": describe(options.device)})


def with_duct(mesh: TriangleMesh, options: argparse.Namespace) -> dict[str, Any]:
    """The same with the duct beside it, by one component outside and by two."""
    duct, found = duct_mesh(options.data), {}
    for scanner, made in SCANNERS.items():
        image = scan(mesh, made, seed=7, beside=duct)
        for outside in (1, 2):
            backend, finish = backends_by_name(options.backend, options.device, options.weights)
            own = FitOptions(blur=made.blur, components=(1, outside))
            result = fit_shape(image.values, image.grid, backend, finish=finish, options=own)
            fitted = surface_of(finish or backend, result)
            free = free_form(image.values, image.grid, fitted, blur=made.blur, device=options.device)
            row = {"residual": residual(mesh, fitted), "residual_free_form": residual(mesh, free.mesh)}
            row |= {"trusted": result.trusted}
            row |= {"problems": list(result.diagnosis.problems), "explained": result.diagnosis.explained}
            found[f"{scanner}, components outside {outside}"] = row
            print(scanner, "mm, duct,", outside, "outside", row)
    return found


def residual(mesh: TriangleMesh, own: TriangleMesh) -> dict[str, float]:
    """Distances between the fitted and the real surface [mm], vertex to surface, both ways."""
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
