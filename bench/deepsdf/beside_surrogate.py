"""DeepSDF beside SDMNN+ and the mesh: the time of one cochlea's map, and of the fit of a shape to a label.

Wang et al., MIDL 2020, Table 1: DeepSDF took 28.1 s for one map, and its fit failed. The fit here: a cochlea that was
not trained on gives a label on a grid of 0.2 mm; the probability that a voxel is inside is sigmoid(-distance / length),
and the most probable shape is looked for by Adam - over the code, the centre and the size of the sphere with DeepSDF,
over the four parameters with the shipped surrogate's maps and with exact ones of the mesh. A fit has failed if its
surface is more than a voxel off.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits as cross_entropy
from torch.nn.functional import grid_sample

from sdm.bench.common.timing import median, once
from sdm.bench.deepsdf.shapes import TEST_SEED
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.deepsdf import DeepSDF, decode_mesh, score_shape
from sdm.deepsdf.samples import UnitSphere
from sdm.engine.many import signed_distance_maps
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import SDMError
from sdm.shapes import Cochlea
from sdm.shapes.sampling import uniform
from sdm.surrogate import GRID, load_surrogate
from sdm.surrogate.train.accuracy import places_in_map

SPACING_MM = 0.2
# Length over which the label's certainty grows [mm].
LENGTH_MM = 0.1
STEPS, VOXELS = 300, 16_384


def whole_maps(model: DeepSDF, family: Cochlea, resolution: int = 64) -> dict[str, Any]:
    """Milliseconds of one map on `resolution`^3 voxels: learned, and exact from the mesh, its build included.

    The surrogate's has a grid of its own.
    """
    device = str(model.device)
    theta = family.sample(1, seed=TEST_SEED, device=device)
    mesh = family.mesh(theta[0])
    sphere, grid = UnitSphere.of(mesh), Grid.around(mesh, resolution=resolution)
    at = grid.points().to(model.device)
    code, surrogate = model.codes[0], load_surrogate(device=device)
    with torch.no_grad():
        calls: dict[str, Callable[[], Any]] = {
            "deepsdf_ms": lambda: model.signed_distance(at, code, sphere),
            "sdmnn_ms": lambda: surrogate(theta),
            "mesh_ms": lambda: signed_distance_maps(family.vertices(theta), family.faces_on(device), grid),
        }
        result: dict[str, Any] = {"resolution": resolution, "triangles": len(mesh), "sdmnn_voxels": GRID.size}
        for name, call in calls.items():
            once(call, device)
            result[name] = median(call, device, 10, 20_000).ms
    return result


def fits(model: DeepSDF, family: Cochlea, count: int, steps: int = STEPS) -> dict[str, Any]:
    """Fits of `count` cochleas in each way."""
    device = str(model.device)
    surrogate, faces = load_surrogate(device=device).requires_grad_(False), family.faces_on(device)

    def learned(label: Tensor, grid: Grid, steps: int) -> TriangleMesh:
        at = places_in_map(grid.points().to(device))[None]
        maps = lambda theta: grid_sample(surrogate(theta), at, padding_mode="border", align_corners=True)  # noqa: E731
        return by_parameters(family, maps, label, steps)

    def exact(label: Tensor, grid: Grid, steps: int) -> TriangleMesh:
        maps = lambda theta: signed_distance_maps(family.vertices(theta), faces, grid)  # noqa: E731
        return by_parameters(family, maps, label, steps)

    ways: dict[str, Callable[[Tensor, Grid, int], TriangleMesh]] = {
        "deepsdf": lambda label, grid, steps: by_code(model, label, grid, steps),
        "sdmnn": learned,
        "mesh": exact,
    }
    result: dict[str, Any] = {"about": {"spacing_mm": SPACING_MM, "steps": steps, "shapes": count}}
    for name, way in ways.items():
        rows = []
        for number in range(count):
            truth = family.mesh(family.sample(1, seed=TEST_SEED, start=number, device=device)[0])
            grid = Grid.around(truth, spacing=SPACING_MM, margin=0.15)
            label = (MeshIndex(truth, device).signed_distance_map(grid).values < 0).float()
            if not rows:
                way(label, grid, 2)
            try:
                ms, mesh = once(lambda label=label, grid=grid, way=way: way(label, grid, steps), device)
            except SDMError as error:
                rows.append({"failed": True, "why": str(error)})
                continue
            found = score_shape(mesh, truth)
            rows.append(
                {
                    "seconds": ms / 1e3,
                    "mean_mm": found.mean,
                    "percentile95_mm": found.percentile95,
                    "dice": found.dice,
                    "failed": found.mean > SPACING_MM,
                }
            )
        result[name] = {"failed": sum(bool(row["failed"]) for row in rows), "rows": rows}
    return result


def by_code(model: DeepSDF, label: Tensor, grid: Grid, steps: int) -> TriangleMesh:
    """The surface of the most probable code and sphere, whose start is the label's own."""
    points = grid.points().to(model.device).reshape(-1, 3)
    inside = label.reshape(-1)
    start = UnitSphere.of(points[inside > 0])
    middle = model.codes.mean(0)
    code = middle.clone().requires_grad_()
    centre = torch.tensor(start.centre, device=model.device, requires_grad=True)
    size = torch.zeros((), device=model.device, requires_grad=True)
    published = model.settings.variant == "published"
    groups = [{"params": [code], "lr": 5e-3 if published else 2e-2}, {"params": [centre, size], "lr": 5e-3}]
    optimizer = torch.optim.Adam(groups)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    prior = model.settings.code_weight
    for step in range(steps):
        number = torch.arange(step * VOXELS, (step + 1) * VOXELS, device=model.device)
        chosen = (uniform(0, number, 1)[:, 0] * len(points)).long()
        radius = start.radius * size.exp()
        unit = (points[chosen] - centre) / radius
        distance = radius * model.signed_distance(unit, code)
        loss = cross_entropy(-distance / LENGTH_MM, inside[chosen]) + prior * (code - middle).square().sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    x, y, z = centre.tolist()
    return decode_mesh(model, code.detach(), sphere=UnitSphere((x, y, z), start.radius * float(size.detach().exp())))


def by_parameters(family: Cochlea, maps: Callable[[Tensor], Tensor], label: Tensor, steps: int) -> TriangleMesh:
    """The mesh of the most probable parameters, from the middle of their box.

    `maps` gives distances (...,nx,ny,nz) at the label's voxels for theta (1,P), differentiably.
    """
    width = len(family.parameters)
    free = torch.zeros(1, width, device=label.device, requires_grad=True)
    optimizer = torch.optim.Adam([free], lr=0.1)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        distance = maps(family.from_unit(free.sigmoid())).reshape(label.shape)
        loss = cross_entropy(-distance / LENGTH_MM, label)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return family.mesh(family.from_unit(free.detach().sigmoid())[0])
