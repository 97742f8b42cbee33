"""Check of a family by samples: closed, outward, not cutting itself, right derivatives, sizes, maps a second."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from sdm.core.device import choose_device
from sdm.core.mesh import TriangleMesh
from sdm.core.random import generator
from sdm.engine.api import signed_distance
from sdm.engine.many import signed_distance_maps
from sdm.inspect import inspect_mesh
from sdm.shapes.family import Family

# Steps of finite differences, as a share of the box, and the relative error that float32 vertices may have there.
STEP, TOLERANCE = 2e-3, 0.02
# Points beside faces are this share of the face's inradius away; faces thinner than this share of the shape are left
# out, whose points float32 cannot place.
BESIDE, THIN = 0.1, 1e-5
RESOLUTION = 64


@dataclass(frozen=True)
class FamilyCheck:
    """Findings of `check_family`; shares are of the samples, lengths in the family's unit.

    Args:
        name: The family's name.
        samples: How many shapes were looked at.
        triangles: Of each.
        closed: Share whose edges all cancel.
        outward: Share whose closed pieces face outward.
        self_crossing: Share in which a face lies inside another part of the surface, or faces into it.
        worst_crossing: Largest share of the faces of one shape that do.
        derivative_error: Largest error of a derivative by one parameter against central differences, relative.
        smallest: Least longest side of a shape's box.
        largest: Greatest one.
        least_volume: Least volume of the closed shapes.
        most_volume: Greatest one.
        maps_per_second: Maps of 64^3 voxels, vertices included, once kernels are compiled.
        device: Where these were made.
        problems: In sentences; empty for a sound family.
    """

    name: str
    samples: int
    triangles: int
    closed: float
    outward: float
    self_crossing: float
    worst_crossing: float
    derivative_error: float
    smallest: float
    largest: float
    least_volume: float | None
    most_volume: float | None
    maps_per_second: float
    device: str
    problems: tuple[str, ...]

    def record(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        return asdict(self)


def check_family(
    family: Family,
    *,
    samples: int = 64,
    seed: int = 0,
    device: torch.device | str | None = None,
) -> FamilyCheck:
    """Look at samples of a family, its centre and, up to 64 of them, the corners of its box.

    Args:
        family: Any.
        samples: Random shapes; the corners come on top.
        seed: Of these.
        device: Where maps and distances are computed.

    Self-crossing is found by the winding number: a point just outside each face has to be outside the whole shape, and
    one just inside has to be inside.
    """
    where = choose_device(device)
    theta = torch.cat([special_theta(family), family.sample(samples, seed=seed, device="cpu")])
    rows = [_look(family, one[None], where) for one in theta]
    closed = [row["closed"] for row in rows]
    outward = [row["outward"] for row in rows]
    crossing = [row["crossing"] for row in rows]
    volumes = [row["volume"] for row in rows if row["volume"] is not None]
    error = _derivative_error(family, family.sample(min(8, samples), seed=seed + 1, device="cpu"))
    problems = []
    for found, what in ((closed, "is not closed"), (outward, "does not face outward")):
        if not all(found):
            problems.append(_sentence(what, [not x for x in found], theta, family))
    if any(share > 0 for share in crossing):
        problems.append(_sentence("cuts itself", [share > 0 for share in crossing], theta, family))
    if not error <= TOLERANCE:
        problems.append(f"derivatives differ from finite differences by up to {100 * error:.3g} %")
    return FamilyCheck(
        name=family.name,
        samples=len(theta),
        triangles=family.triangles_per_sample,
        closed=sum(closed) / len(closed),
        outward=sum(outward) / len(outward),
        self_crossing=sum(share > 0 for share in crossing) / len(crossing),
        worst_crossing=max(crossing),
        derivative_error=error,
        smallest=min(row["size"] for row in rows),
        largest=max(row["size"] for row in rows),
        least_volume=min(volumes, default=None),
        most_volume=max(volumes, default=None),
        maps_per_second=_pace(family, where),
        device=str(where),
        problems=tuple(problems),
    )


def special_theta(family: Family, corners: int = 64) -> Tensor:
    """The centre of the box (1 + C, P), and its corners where they are few."""
    count = len(family.parameters)
    unit = [torch.full((1, count), 0.5, device="cpu")]
    if 2**count <= corners:
        axes = [torch.tensor([0.0, 1.0], device="cpu")] * count
        unit.append(torch.cartesian_prod(*axes).reshape(-1, count))
    return family.from_unit(torch.cat(unit))


def _look(family: Family, theta: Tensor, device: torch.device) -> dict[str, Any]:
    with torch.no_grad():
        group = next(iter(family.groups(theta, theta)))
    vertices, faces = group.vertices[0].detach().cpu(), group.faces.cpu()
    mesh = TriangleMesh(vertices, faces, family.name, check=False)
    report = inspect_mesh(mesh)
    size = float((vertices.amax(0) - vertices.amin(0)).max())
    return {
        "closed": report.closed,
        "outward": bool(report.outward),
        "crossing": crossing_share(mesh, size, device) if report.closed else 0.0,
        "volume": report.volume,
        "size": size,
    }


def crossing_share(mesh: TriangleMesh, size: float, device: torch.device) -> float:
    """Share of a closed mesh's faces that lie in another part of it, or face into it.

    Args:
        mesh: Closed.
        size: The longest side of its box.
        device: Where distances are computed.
    """
    a, b, c = mesh.vertices.detach().double()[mesh.faces.long()].unbind(1)
    across = torch.linalg.cross(b - a, c - a)
    double = across.norm(dim=1)
    around = (b - a).norm(dim=1) + (c - b).norm(dim=1) + (a - c).norm(dim=1)
    inradius = double / around.clamp_min(1e-300)
    used = inradius > THIN * size
    if not bool(used.any()):
        return 0.0
    offset = (BESIDE * inradius / double.clamp_min(1e-300))[:, None] * across
    centre = (a + b + c) / 3
    points = torch.cat([(centre + offset)[used], (centre - offset)[used]]).float()
    outside, inside = signed_distance(mesh, points.to(device), device=device).cpu().chunk(2)
    wrong = (outside < 0) | (inside > 0)
    return float(wrong.sum()) / len(mesh.faces)


def _derivative_error(family: Family, theta: Tensor) -> float:
    """Largest relative error of the derivatives of a random sum of vertices, parameter by parameter."""
    width = len(family.parameters)
    unit = family.to_unit(theta).clamp(0.02, 0.98)
    worst = 0.0
    for number, place in enumerate(unit):
        here = family.from_unit(place[None]).requires_grad_()
        points = family.vertices(here)
        signs = (
            torch.randint(0, 2, points.shape, generator=generator(0, "family check", number), device="cpu") * 2.0 - 1
        )
        if not points.requires_grad:
            return float("inf")
        (found,) = torch.autograd.grad((points.double() * signs).sum(), here)
        with torch.no_grad():
            step = STEP * torch.tensor([max(p.high - p.low, 0.0) for p in family.parameters], device="cpu")
            ends = here + torch.cat([torch.diag(step), -torch.diag(step)])
            span = (ends[:width] - ends[width:]).diagonal().double()
            moved = family.vertices(ends).double()
            change = moved[:width] - moved[width:]
            wanted = (change * signs).sum((1, 2)) / span.clamp_min(1e-30)
            # The scale of a random sum, so that one that happens to cancel is no error.
            scale = change.flatten(1).norm(dim=1) / span.clamp_min(1e-30)
            # Rounding of the vertices is no error of a derivative.
            floor = 1e-6 * points.abs().max().double() * points[0].numel() ** 0.5 / span.clamp_min(1e-30)
            error = ((found[0] - wanted).abs() - floor).clamp_min(0) / scale.clamp_min(1e-12)
            # A parameter that chooses among shapes has no derivative.
            error = error[(step > 0) & (scale > 0) & (found[0].abs() + floor > 0)]
        if len(error):
            worst = max(worst, float(error.max()))
    return worst


def _pace(family: Family, device: torch.device) -> float:
    grid = family.grid(RESOLUTION)
    theta = family.sample(4, seed=2, device="cpu").to(device)

    def make() -> None:
        with torch.no_grad():
            for one in theta.split(2):
                vertices = family.vertices(one)
                signed_distance_maps(vertices, family.faces_on(device), grid, device=device)
        if device.type == "cuda":
            torch.cuda.synchronize(device)

    make()
    start = time.perf_counter()
    make()
    return len(theta) / (time.perf_counter() - start)


def _sentence(what: str, bad: list[bool], theta: Tensor, family: Family) -> str:
    first = theta[bad.index(True)].tolist()
    place = ", ".join(f"{p.name} {x:.4g}" for p, x in zip(family.parameters[:6], first, strict=False))
    return f"{sum(bad)} of {len(bad)} shapes {what}: the first at {place}" + (", ..." if len(first) > 6 else "")
