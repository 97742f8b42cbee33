"""Encoding: from meshes and scans to codes, in the users' own coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from sdm.core.as_mesh import MeshLike, as_mesh
from sdm.core.random import derive_seed
from sdm.deepsdf.infer.code_file import ShapeCode
from sdm.deepsdf.infer.estimate_codes import check_steps, estimate_codes
from sdm.deepsdf.infer.scan import Scan
from sdm.deepsdf.networks.model import DeepSDF
from sdm.deepsdf.samples import Samples, ShapeSet, UnitSphere
from sdm.deepsdf.samples.usable_shapes import why_unusable
from sdm.errors import MeshError, SDMError

# Samples of a step, as published.
POINTS = 8000


def encode_meshes(
    model: DeepSDF,
    meshes: Sequence[MeshLike],
    *,
    steps: int = 800,
    points: int = POINTS,
    seed: int = 0,
    spheres: Sequence[UnitSphere] | None = None,
    **options: Any,
) -> list[ShapeCode]:
    """The codes of whole shapes, all at once, from exact samples that are fresh in each step.

    Args:
        model: A trained model.
        meshes: Closed meshes, as `as_mesh` takes them; one that is inside out is turned first.
        steps: Of the search.
        points: Samples of each shape and step.
        seed: Of the samples.
        spheres: The meshes' normalisations; their own unit spheres if not given.
        options: Those of `estimate_codes`.

    Raises:
        MeshError: No meshes, or one that is not closed.
        SDMError: No steps.
    """
    check_steps(steps)
    found = [as_mesh(mesh) for mesh in meshes]
    for mesh in found:
        if (why := why_unusable(mesh)) is not None:
            raise MeshError(
                f"{mesh.name} cannot be encoded: {why}; sdm watertight closes it, and encode_scan (--scan) takes its "
                "vertices alone"
            )
    shapes = ShapeSet(found, model.device, spheres=spheres)
    every = torch.arange(len(shapes), device=model.device)

    # Other samples than a training of the same seed has had.
    own = derive_seed(seed, "code of a mesh")

    def draw(step: int) -> Samples:
        return shapes.sample(every, points, seed=own, step=step)

    codes = estimate_codes(model, draw, steps=steps, **options).codes
    return [ShapeCode(code, sphere) for code, sphere in zip(codes, shapes.spheres, strict=True)]


def encode_scan(
    model: DeepSDF,
    points: Any,
    normals: Any = None,
    *,
    sphere: UnitSphere | None = None,
    steps: int = 800,
    seed: int = 0,
    **options: Any,
) -> ShapeCode:
    """The code of a shape of which only some points of the surface are known: completion.

    Args:
        model: A trained model.
        points: (N,3) in the sphere's unit, at least 100.
        normals: (N,3) outward, if they are known: then which side is inside is known too.
        sphere: The whole shape's unit sphere. If not given, that around the points, which is right for scans of all
            sides only.
        steps: Of the search.
        seed: Of the points that each step takes.
        options: Those of `estimate_codes`.

    Raises:
        SDMError: No steps, fewer than 100 points, a point that is not finite, normals that do not fit, or a sphere that
            most of the points are outside of.
    """
    check_steps(steps)
    at = model.check_points(points)
    if at.ndim != 2:
        raise SDMError(f"the scan has the shape {tuple(at.shape)}; (N, 3) is needed")
    # Said here too, since a sphere around no points has no radius.
    Scan(at, normals)
    sphere = sphere or UnitSphere.of(at)
    unit = sphere.to_unit(at)
    # Of a scan with noise a few may well be.
    outside = int((unit.norm(dim=1) > 1).sum())
    if 2 * outside > len(unit):
        raise SDMError(
            f"{outside} of the {len(unit)} points of the scan are outside the sphere with centre {sphere.centre} and "
            f"radius {sphere.radius}: give that around the whole shape, in the scan's unit"
        )
    scan = Scan(unit, normals, count=POINTS // 2, seed=seed)
    return ShapeCode(estimate_codes(model, scan, steps=steps, **options).codes[0], sphere)
