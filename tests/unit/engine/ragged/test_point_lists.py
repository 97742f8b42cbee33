"""Points of lists of meshes: asked about together, in packets of one mesh each."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import cube, sphere, torus
from sdm.bench.dense.launch_counts import Counts, counting
from sdm.engine.plan_override import plan_override
from sdm.engine.ragged import joint_points
from sdm.engine.ragged.joint_points import ragged_points
from sdm.engine.ragged.structure import RaggedBuild
from sdm.kernels import launch as launches
from sdm.topology import device_joining

CLOSED = [sdm.TriangleMesh(*shape) for shape in (cube(), sphere(9), torus(400), sphere(12))]
OPEN = sdm.TriangleMesh(CLOSED[1].vertices, CLOSED[1].faces[3:])


@pytest.fixture
def queries(monkeypatch):
    """Numbers of packets that each query asks about."""
    made: list[int] = []

    def counted(*args):
        made.append(args[-1].shape[0])
        return joint_points_query(*args)

    joint_points_query = joint_points.query_points
    monkeypatch.setattr(joint_points, "query_points", counted)
    return made


def test_one_query_for_all_closed_meshes(queries):
    points = [torch.randn(count, 3) for count in (33, 0, 32, 1)]
    found = sdm.signed_distances(CLOSED, points, device="cpu")
    # Two packets, none, one and one.
    assert queries == [4]
    for values, mesh, at in zip(found, CLOSED, points, strict=True):
        assert torch.equal(values, sdm.signed_distance(mesh, at, device="cpu"))


def test_those_with_holes_have_a_query_of_their_own_if_the_sign_matters(queries):
    meshes, points = [CLOSED[0], OPEN, CLOSED[2], OPEN.flipped()], torch.randn(4, 40, 3)
    for sign, packets in (("winding", [4, 4]), ("none", [8])):
        queries.clear()
        found = sdm.signed_distances(meshes, points, device="cpu", sign=sign)
        assert queries == packets
        for values, mesh, at in zip(found, meshes, points, strict=True):
            assert torch.equal(values, sdm.signed_distance(mesh, at, device="cpu", sign=sign))


def test_shapes_and_points_that_are_not_finite():
    points = [torch.full((2, 5, 3), torch.nan), torch.randn(3), torch.randn(0, 4, 3), torch.randn(1, 3)]
    for (values, hit), at, mesh in zip(
        sdm.signed_distances(CLOSED, points, device="cpu", return_closest=True), points, CLOSED, strict=True
    ):
        assert values.shape == hit.faces.shape == at.shape[:-1]
        assert hit.points.shape == hit.barycentric.shape == hit.directions.shape == at.shape
        assert hit.interpolate(mesh.vertices).shape == at.shape
    assert sdm.signed_distances(CLOSED, points, device="cpu")[0].isnan().all()


def test_gradients_flow_to_points_and_vertices():
    moving = sdm.TriangleMesh(CLOSED[1].vertices.clone().requires_grad_(), CLOSED[1].faces)
    points = [torch.randn(7, 3) for _ in range(3)]
    points[2].requires_grad_()
    found = sdm.signed_distances([CLOSED[0], moving, CLOSED[2]], points, device="cpu")
    torch.cat(found).sum().backward()
    assert moving.vertices.grad is not None
    assert points[2].grad is not None
    assert not found[0].requires_grad


def test_no_points_at_all():
    assert [values.shape for values in sdm.signed_distances(CLOSED, torch.zeros(4, 0, 3), device="cpu")] == [(0,)] * 4


def test_some_meshes_of_a_structure():
    structure = RaggedBuild(CLOSED).finish(range(4))
    points = [torch.randn(50, 3), torch.randn(9, 3)]
    for place, at, (values,) in zip((1, 3), points, ragged_points(structure, [1, 3], points, False), strict=True):
        assert torch.equal(values, sdm.signed_distance(CLOSED[place], at, device="cpu"))


def test_points_of_a_bad_shape_are_named():
    with pytest.raises(sdm.MeshError, match=r"^mesh 1: the points have shape \(2, 2\)"):
        sdm.signed_distances(CLOSED[:2], [torch.zeros(2, 3), torch.zeros(2, 2)], device="cpu")


def counted(count: int, monkeypatch: pytest.MonkeyPatch) -> Counts:
    """Counts of what is queued for points of so many open meshes, with dipoles or without, as on a GPU."""
    monkeypatch.setattr(device_joining, "JOINING_DEVICES", ("cpu",))
    monkeypatch.setattr(launches, "threads", lambda: 1)
    rng = np.random.default_rng(count)
    vertices, faces = torus(1600)
    meshes = [sdm.TriangleMesh(vertices, faces[rng.random(1600) > (0.02, 0.5)[i % 2]]) for i in range(count)]
    points = [torch.randn(70, 3) for _ in meshes]
    with plan_override(points_method="lists"), counting() as counts:
        structure = RaggedBuild(meshes).finish(range(count))
        ragged_points(structure, range(count), points, hits=True)
    assert {kind.name for kind in structure.kinds.values()} == {"OPEN", "DIRTY"}
    return counts


def test_as_much_is_queued_for_many_open_meshes_as_for_few(monkeypatch):
    few, many = (counted(count, monkeypatch).found for count in (4, 32))
    # Without steps that double, from edge to edge or up to all that are sorted: of more there are a few more.
    steps = {"_look_ahead", "_count_onward"}
    for kind in ("kernels", "memsets", "sorts", "torch", "reads"):
        one, other = ({k: n for k, n in found[kind].items() if k not in steps} for found in (few, many))
        assert sum(other.values()) <= sum(one.values()) + 8, (kind, one, other)
    # The pairing's flags, and the boundaries.
    assert many["reads"]["tolist"] == 2
    assert not {name for name in many["reads"] if name not in ("tolist", "repeat_interleave", "_local_scalar_dense")}
