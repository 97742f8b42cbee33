"""Statistical shape models from meshes: correspondence, alignment, principal components."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from sdm.core.device import choose_device
from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError
from sdm.inspect import inspect_mesh
from sdm.shapes.models.even_template import even_template
from sdm.shapes.models.lay_template import TemplateLayer
from sdm.shapes.models.measures import compactness, generalisation, specificity
from sdm.shapes.models.procrustes import procrustes
from sdm.shapes.models.statistical_shape import LIMIT, MOST_MODES, StatisticalShape

# Share of the variance that the modes hold if their number is not given.
SHARE = 0.98
TRIANGLES = 6000


def build_model(
    meshes: Sequence[TriangleMesh],
    *,
    scale: bool = False,
    modes: int | None = None,
    template: TriangleMesh | None = None,
    triangles: int = TRIANGLES,
    correspond: bool | None = None,
    limit: float = LIMIT,
    device: torch.device | str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> StatisticalShape:
    """A shape model of meshes.

    Args:
        meshes: Three or more closed meshes in one unit. In correspondence, they have the same faces; else they lie
            and face roughly alike.
        scale: Take sizes out before modes are found.
        modes: How many modes; by default those that hold 98 % of the variance.
        template: For meshes without correspondence, the mesh that is laid onto each; by default one of them, of middle
            volume, with even triangles.
        triangles: About how many triangles that one has.
        correspond: False lays a template even onto meshes with the same faces; by default it is done where they differ.
        limit: Deviations that the model's box reaches to each side.
        device: Where a template is laid.
        progress: Called with the number of meshes done and of all.

    Returns:
        The model, about its own middle. Its `facts` say for each mesh how far the template is from it (`distance`, the
        mean of both ways, and `most`), how many faces turned over (`turned`) or lie in another part of it (`cut`); and
        the model's compactness, generalisation and specificity.

    Raises:
        MeshError: Too few meshes, one that is not closed, or a number that makes no sense.
    """
    count = len(meshes)
    if count < 3:
        raise MeshError(f"a shape model needs three meshes or more, not {count}")
    if modes is not None and not 1 <= modes <= min(count - 1, MOST_MODES):
        raise MeshError(f"{modes} modes of {count} meshes were requested; give 1 to {min(count - 1, MOST_MODES)}")
    same = all(m.faces.shape == meshes[0].faces.shape and torch.equal(m.faces, meshes[0].faces) for m in meshes)
    corresponding = same and template is None and correspond is not False
    if correspond and not corresponding:
        raise MeshError("the meshes do not have the same faces: lay a template onto them (correspond=None)")
    rows: list[dict[str, Any]] = [{"name": mesh.name} for mesh in meshes]
    if corresponding:
        faces = meshes[0].faces.cpu()
        points = torch.stack([mesh.vertices.detach().cpu() for mesh in meshes])
    else:
        points, faces = _laid(meshes, template, triangles, choose_device(device), rows, progress)
    return model_of(points, faces, scale=scale, modes=modes, limit=limit, facts={"shapes": rows})


def model_of(
    points: Tensor, faces: Tensor, *, scale: bool, modes: int | None, limit: float, facts: dict[str, Any]
) -> StatisticalShape:
    """The model of shapes (N,V,3) in correspondence: Procrustes, then principal components."""
    aligned, mean = procrustes(points, scale=scale)
    directions, deviations = principal_components(aligned - mean)
    if not bool(deviations[0] > 1e-9 * mean.norm()):
        raise MeshError("the meshes are all alike but for their places: there are no modes of variation")
    shares = compactness(deviations)
    kept = int((shares < SHARE).sum()) + 1 if modes is None else modes
    kept = min(kept, len(deviations), MOST_MODES)
    shown = [m for m in range(1, len(deviations)) if m <= 20 or m % 10 == 0]
    facts = {
        **facts,
        "scale": scale,
        "compactness": [round(x, 6) for x in shares.tolist()],
        "generalisation": generalisation(aligned, shown),
        "specificity": specificity(aligned, directions, deviations, shown),
    }
    return StatisticalShape(mean, directions[:kept], deviations[:kept], faces, limit=limit, facts=facts)


def principal_components(centred: Tensor) -> tuple[Tensor, Tensor]:
    """Modes (N-1,V,3), orthonormal, and standard deviations (N-1,) of shapes (N,V,3) about their mean, largest first.

    A mode's sign is such that its largest number is positive, so that models of other machines have the same.
    """
    count = len(centred)
    _, values, vt = torch.linalg.svd(centred.flatten(1), full_matrices=False)
    modes, deviations = vt[: count - 1], values[: count - 1] / (count - 1) ** 0.5
    sign = modes.gather(1, modes.abs().argmax(1, keepdim=True)).sign()
    return (modes * sign).reshape(-1, *centred.shape[1:]), deviations


def _laid(
    meshes: Sequence[TriangleMesh],
    template: TriangleMesh | None,
    triangles: int,
    device: torch.device,
    rows: list[dict[str, Any]],
    progress: Callable[[int, int], None] | None,
) -> tuple[Tensor, Tensor]:
    volumes = []
    for mesh in meshes:
        report = inspect_mesh(mesh)
        if not report.closed or not report.volume or report.volume < 0:
            what = "is not closed" if not report.closed else "is inside out" if report.volume else "encloses nothing"
            raise MeshError(f"{mesh.name} {what}: a template is laid onto closed meshes that face outward")
        volumes.append(report.volume)
    if template is None:
        middle = sorted(range(len(meshes)), key=volumes.__getitem__)[len(meshes) // 2]
        template = even_template(meshes[middle], triangles, device)
    layer = TemplateLayer(template, device)
    found = []
    for number, (mesh, row) in enumerate(zip(meshes, rows, strict=True)):
        laid = layer.lay(mesh)
        row |= {
            "distance": round(laid.distance, 5),
            "most": round(laid.most, 4),
            "turned": laid.turned,
            "cut": laid.cut,
        }
        found.append(laid.vertices.cpu())
        if progress is not None:
            progress(number + 1, len(meshes))
    return torch.stack(found), template.faces.cpu()
