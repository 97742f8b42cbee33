"""Scores of a trained DeepSDF: known shapes, unseen shapes, completion, time."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import torch
from torch import Tensor

from sdm.bench.common.timing import once
from sdm.core.mesh import TriangleMesh
from sdm.deepsdf import DeepSDF, Scan, ShapeScores, decode_mesh, estimate_codes, half_of, score_shape
from sdm.deepsdf.infer.encode import POINTS
from sdm.deepsdf.infer.estimate_codes import Draw
from sdm.deepsdf.samples import Samples, ShapeSet, UnitSphere, surface_points
from sdm.engine.api import signed_distance
from sdm.errors import SDMError

# Points of a scan, and the deviation of a noisy one's points in unit-sphere radii.
SCAN, NOISE = 10_000, 0.01
# What codes are looked for from.
SEARCHES = ("unseen", "half", "noisy")
UNIT = UnitSphere((0.0, 0.0, 0.0), 1.0)


class Found(NamedTuple):
    """Codes (B,D) of a search, and what it took."""

    codes: Tensor
    seconds_a_shape: float
    steps: int


def scores_of(
    model: DeepSDF, codes: Tensor, truth: Callable[[int], TriangleMesh], radii: list[float], resolution: int
) -> dict[str, Any]:
    """Scores of codes against their true normalised meshes, with distances in mm, and their means and medians."""
    rows, failed = [], 0
    for number, code in enumerate(codes):
        try:
            mesh = decode_mesh(model, code, resolution=resolution)
        except SDMError:
            failed += 1
            continue
        found = score_shape(mesh, truth(number).to(model.device), sphere=UNIT)
        row = asdict(found)
        for name in ("mean", "percentile95"):
            row[f"{name}_mm"] = radii[number] * row.pop(name)
        rows.append(row)
    return {"shapes": len(codes), "without_a_surface": failed, **summary(rows), "rows": rows}


def summary(rows: list[dict[str, float]]) -> dict[str, Any]:
    """Mean and median of each column."""
    if not rows:
        return {}
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    return {
        "mean": {name: statistics.fmean(column) for name, column in columns.items()},
        "median": {name: statistics.median(column) for name, column in columns.items()},
    }


def known(model: DeepSDF, training: list[TriangleMesh], most: int, resolution: int) -> dict[str, Any]:
    """Representation: shapes of the training, by the codes that the training found."""
    spheres = list(model.spheres[:most])
    meshes = [s.normalised(m) for s, m in zip(spheres, training[:most], strict=True)]
    return scores_of(model, model.codes[:most], meshes.__getitem__, [s.radius for s in spheres], resolution)


def search(
    model: DeepSDF,
    test: list[TriangleMesh],
    steps: int,
    prior: float | None,
    compiled: bool,
    which: Sequence[str] = SEARCHES,
    count: int = POINTS,
) -> dict[str, Found]:
    """Codes of shapes that the training never saw, by maximum a posteriori estimation, all at once.

    `unseen`: from exact samples of the whole shape. `half`: from points of the half of the surface that faces one
    direction, with normals. `noisy`: from points of all of it with noise and without normals. `count` samples a step.
    """
    device = str(model.device)
    shapes = ShapeSet(test, device)
    truths = [shapes.mesh(n) for n in range(len(shapes))]
    points, normals = scans(truths)
    seen = seen_half(points)
    noise = torch.randn(points.shape, generator=torch.Generator().manual_seed(9)).to(points)
    half = Scan(_chosen(points, seen), _chosen(normals, seen), count=count // 2)
    noisy = Scan(points + NOISE * noise, count=count)
    every = torch.arange(len(shapes), device=device)
    draws: dict[str, tuple[Draw, float | None]] = {
        "unseen": (lambda step: shapes.sample(every, count, step=step), None),
        "half": (half, prior),
        "noisy": (noisy, prior),
    }
    found = {}
    for name in which:
        draw, weight = draws[name]
        if compiled:
            # Compiling is paid once a machine; what users wait for is the search.
            estimate_codes(model, draw, steps=3, prior=weight, compile_network=True)
        ms, best = once(
            lambda draw=draw, weight=weight: estimate_codes(
                model, draw, steps=steps, prior=weight, compile_network=compiled
            ),
            device,
        )
        found[name] = Found(best.codes.cpu(), ms / 1e3 / len(test), steps)
    return found


def unseen(model: DeepSDF, test: list[TriangleMesh], found: Found, resolution: int) -> dict[str, Any]:
    """Representation of unseen shapes."""
    spheres = [UnitSphere.of(m) for m in test]
    meshes = [s.normalised(m) for s, m in zip(spheres, test, strict=True)]
    scores = scores_of(model, found.codes, meshes.__getitem__, [s.radius for s in spheres], resolution)
    return {"steps": found.steps, "seconds_a_shape": found.seconds_a_shape, **scores}


def completion(model: DeepSDF, test: list[TriangleMesh], found: Found, resolution: int) -> dict[str, Any]:
    """Errors on the half of the surface that a scan from one side saw, and on the other one."""
    spheres = [UnitSphere.of(m) for m in test]
    truths = [s.normalised(m).to(model.device) for s, m in zip(spheres, test, strict=True)]
    points, _ = scans(truths)
    radii = [s.radius for s in spheres]
    rows = list(_parts(model, found.codes, truths, points, seen_half(points), radii, resolution))
    about = {"points": SCAN, "noise": NOISE, "steps": found.steps, "seconds_a_shape": found.seconds_a_shape}
    return {**about, "shapes": len(test), **summary(rows), "rows": rows}


def scans(truths: list[TriangleMesh]) -> tuple[Tensor, Tensor]:
    """Points (B,N,3) and normals of normalised surfaces."""
    points, normals = zip(*(surface_points(truth, SCAN, seed=9) for truth in truths), strict=True)
    return torch.stack(points), torch.stack(normals)


def seen_half(points: Tensor) -> Tensor:
    """Mask (B,N) of the points (B,N,3) of shapes on the half that faces one direction."""
    direction = torch.nn.functional.normalize(torch.tensor([1.0, -0.7, 0.4]), dim=0)
    return torch.stack([half_of(p, direction) for p in points])


def _chosen(values: Tensor, seen: Tensor) -> Tensor:
    """Rows of each shape, as many for all."""
    most = int(seen.sum(1).min())
    return torch.stack([v[s][:most] for v, s in zip(values, seen, strict=True)])


def _parts(
    model: DeepSDF,
    codes: Tensor,
    truths: list[TriangleMesh],
    points: Tensor,
    seen: Tensor,
    radii: list[float],
    resolution: int,
) -> Iterator[dict[str, float]]:
    for code, truth, at, half, radius in zip(codes, truths, points, seen, radii, strict=True):
        try:
            mesh = decode_mesh(model, code, resolution=resolution)
        except SDMError:
            continue
        away = signed_distance(mesh, at).abs()
        found: ShapeScores = score_shape(mesh, truth, sphere=UNIT)
        names = ("chamfer", "chamfer_paper", "emd", "accuracy", "completion", "normal_cosine", "dice")
        yield {
            **{name: getattr(found, name) for name in names},
            "seen_half_mean_mm": radius * float(away[half].mean()),
            "other_half_mean_mm": radius * float(away[~half].mean()),
            "other_half_95_mm": radius * float(away[~half].quantile(0.95)),
        }


def speed(model: DeepSDF, mesh: TriangleMesh) -> dict[str, float]:
    """Seconds of what users do with one shape, each done once before."""
    shapes = ShapeSet([mesh], model.device)
    one = torch.zeros(1, dtype=torch.int64, device=model.device)
    code, device = model.codes[0], str(model.device)
    samples: Samples = shapes.sample(one, 100_000)
    calls: dict[str, Callable[[], Any]] = {
        "mesh_256": lambda: decode_mesh(model, code, resolution=256),
        "mesh_128": lambda: decode_mesh(model, code, resolution=128),
        "distances_of_100000_points": lambda: model.signed_distance(samples.points[0], code),
        "normals_of_100000_points": lambda: model.normals(samples.points[0], code),
    }
    result = {}
    for name, call in calls.items():
        call()
        start = time.perf_counter()
        call()
        if device.startswith("cuda"):
            torch.cuda.synchronize()
        result[f"seconds_{name}"] = time.perf_counter() - start
    return result
