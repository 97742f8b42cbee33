"""Scores of the DeepSDF study: each shape's, by name, in the paper's scale and in mm."""

from __future__ import annotations

from collections.abc import Iterator

from torch import Tensor

from sdm.bench.deepsdf import evaluate as evaluation
from sdm.core.mesh import TriangleMesh
from sdm.deepsdf import DeepSDF, decode_mesh, score_shape
from sdm.deepsdf.samples import UnitSphere
from sdm.engine.api import signed_distance
from sdm.errors import SDMError

# What a surface that is not there scores.
NOTHING = {"dice": 0.0, "completion": 0.0, "normal_cosine": 0.0}
IN_PAPERS_SCALE = ("chamfer_paper", "chamfer_paper_floor", "emd", "emd_floor", "accuracy")
OTHERS = ("completion", "normal_cosine", "dice")


def whole_scores(
    model: DeepSDF, codes: Tensor, meshes: list[TriangleMesh], resolution: int
) -> Iterator[tuple[str, dict[str, float]]]:
    """Name and scores of each shape by its code."""
    for code, mesh in zip(codes, meshes, strict=True):
        sphere = UnitSphere.of(mesh)
        found = surface_of(model, code, resolution)
        yield mesh.name, scores(found, sphere.normalised(mesh).to(model.device), sphere.radius)


def half_scores(
    model: DeepSDF, codes: Tensor, meshes: list[TriangleMesh], resolution: int
) -> Iterator[tuple[str, dict[str, float]]]:
    """The same of shapes half of whose surface was seen, and the distances of both halves in mm."""
    spheres = [UnitSphere.of(m) for m in meshes]
    truths = [s.normalised(m).to(model.device) for s, m in zip(spheres, meshes, strict=True)]
    points, _ = evaluation.scans(truths)
    seen = evaluation.seen_half(points)
    for code, mesh, sphere, truth, at, half in zip(codes, meshes, spheres, truths, points, seen, strict=True):
        found = surface_of(model, code, resolution)
        yield mesh.name, scores(found, truth, sphere.radius) | halves(found, at, half, sphere.radius)


def surface_of(model: DeepSDF, code: Tensor, resolution: int) -> TriangleMesh | None:
    """The surface of a code; None if there is none."""
    try:
        return decode_mesh(model, code, resolution=resolution)
    except SDMError:
        return None


def scores(mesh: TriangleMesh | None, truth: TriangleMesh, radius: float) -> dict[str, float]:
    """Scores of a surface in the unit sphere: the paper's in its scale, distances in mm."""
    if mesh is None:
        return dict.fromkeys((*IN_PAPERS_SCALE, "mean_mm", "percentile95_mm"), float("inf")) | NOTHING
    found = score_shape(mesh, truth, sphere=evaluation.UNIT)
    lengths = {"mean_mm": radius * found.mean, "percentile95_mm": radius * found.percentile95}
    return {name: getattr(found, name) for name in (*IN_PAPERS_SCALE, *OTHERS)} | lengths


def halves(mesh: TriangleMesh | None, points: Tensor, seen: Tensor, radius: float) -> dict[str, float]:
    """Mean distance in mm from the points of the half that was seen, and of the other one."""
    if mesh is None:
        return dict.fromkeys(("seen_mm", "other_mm"), float("inf"))
    away = signed_distance(mesh, points).abs()
    return {"seen_mm": radius * float(away[seen].mean()), "other_mm": radius * float(away[~seen].mean())}
