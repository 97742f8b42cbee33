"""The index for points alone: the bits of the whole one, whatever the mesh, the number of points and their order."""

from __future__ import annotations

import pytest
import torch

from sdm.bench.common.meshes import load_case
from sdm.core.mesh import TriangleMesh
from sdm.engine.acceleration import MeshKind
from sdm.engine.mesh_index import MeshIndex
from sdm.engine.ops import CPU_SORT, points_closest
from sdm.engine.plan_override import plan_override
from sdm.engine.points import PointsIndex, without_sign


@pytest.mark.parametrize("name", ["torus", "open hemisphere", "repeated faces", "needle box", "overlapping shells"])
def test_equals_the_whole_index(name):
    case = load_case(name)
    mesh = TriangleMesh(case.vertices, case.faces)
    low, high = (torch.tensor(corner, dtype=torch.float32) for corner in mesh.bounds)
    random = torch.Generator().manual_seed(0)
    points = low + (1.4 * torch.rand(2 * CPU_SORT, 3, generator=random) - 0.2) * (high - low)
    points[7] = torch.nan
    points_alone, whole = PointsIndex(mesh, "cpu"), MeshIndex(mesh, "cpu", warn=False)
    for sign in ("winding", "none"):
        found, hit = points_alone.signed_distance(points, return_closest=True, sign=sign)
        wanted, wanted_hit = whole.signed_distance(points, return_closest=True, sign=sign)
        assert torch.equal(found.view(torch.int32), wanted.view(torch.int32))
        assert torch.equal(hit.faces, wanted_hit.faces)
    # Few points are gone through as they come: the same bits.
    one_by_one = torch.cat([points_alone.signed_distance(part) for part in points.split(CPU_SORT // 4)])
    assert torch.equal(one_by_one.view(torch.int32), whole.signed_distance(points).view(torch.int32))


def test_sides_are_each_points_own():
    """A side goes from one point to the next only where no surface is between: those asked alone have the same."""
    case = load_case("hollow sphere")
    mesh = TriangleMesh(case.vertices, case.faces)
    random = torch.Generator().manual_seed(0)
    corner = mesh.vertices[torch.randint(len(mesh.vertices), (300,), generator=random)]
    points = torch.cat([corner * (1.0 + 0.02 * torch.randn(300, 1, generator=random)), 1.5 * corner, 0.3 * corner])
    index = PointsIndex(mesh, "cpu")
    together = index.signed_distance(points)
    alone = torch.cat([index.signed_distance(point[None]) for point in points])
    assert torch.equal(together, alone)
    assert 0 < int((together < 0).sum()) < len(points)


def test_lists_have_what_they_read():
    case = load_case("torus")
    points = torch.rand(100, 3, generator=torch.Generator().manual_seed(1))
    mesh = TriangleMesh(case.vertices, case.faces)
    wanted = MeshIndex(mesh, "cpu", warn=False).signed_distance(points)
    with plan_override(points_method="lists"):
        assert torch.equal(PointsIndex(mesh, "cpu").signed_distance(points), wanted)


@pytest.mark.parametrize("method", ["search", "lists"])
@pytest.mark.parametrize(
    ("name", "share", "kind"),
    [
        ("torus-20000", 1.0, MeshKind.CLOSED),
        ("torus-20000", 0.999, MeshKind.OPEN),
        ("torus-20000", 0.9, MeshKind.DIRTY),
        ("repeated faces", 1.0, None),
    ],
)
def test_without_a_sign_none_is_looked_for(name, share, kind, method, device):
    """Distances and hits are those with a sign, though nothing is there by which one could be found."""
    case, random = load_case(name), torch.Generator().manual_seed(2)
    kept = torch.rand(len(case.faces), generator=random) < share
    mesh = TriangleMesh(case.vertices, torch.from_numpy(case.faces)[kept], check=False)
    low, high = (torch.tensor(corner, dtype=torch.float32) for corner in mesh.bounds)
    points = (low + (1.4 * torch.rand(700, 3, generator=random) - 0.2) * (high - low)).to(device)
    points[7] = torch.nan
    with plan_override(points_method=method):
        index = MeshIndex(mesh, device, warn=False)
        assert kind in (None, index._structure.kind)
        wanted, wanted_hit = index.signed_distance(points, return_closest=True)
        found, hit = index.signed_distance(points, return_closest=True, sign="none")
        alone = index.signed_distance(points, sign="none")
    # Null pointers: whoever reads them crashes.
    winding = without_sign(index._structure).view.winding
    assert (winding.moments, winding.boundary.ends, winding.caps.moments) == (None, None, None)
    assert torch.equal(found.view(torch.int32), wanted.abs().view(torch.int32))
    assert torch.equal(alone.view(torch.int32), found.view(torch.int32))
    assert torch.equal(hit.faces, wanted_hit.faces)


def test_past_the_dispatcher_as_by_it(device):
    case = load_case("needle box")
    mesh = TriangleMesh(case.vertices, case.faces).to(device)
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(2)).to(device)
    found = points_closest(mesh.vertices, mesh.faces, points, None)
    for one, wanted in zip(found, torch.ops.sdm.closest(mesh.vertices, mesh.faces, points, [], 0), strict=True):
        assert torch.equal(one, wanted)
