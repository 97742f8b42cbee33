"""Samples of many shapes in one launch: exact, reproducible, and where DeepSDF has them."""

from __future__ import annotations

import math

import pytest
import torch
import trimesh

from sdm import MeshError, TriangleMesh, signed_distance
from sdm.core.random import derive_seed
from sdm.deepsdf.samples import SampleDistribution, ShapeSet, UnitSphere, surface_points
from sdm.deepsdf.samples.shape_set import REACH, STEP, _cube_around, _places
from sdm.errors import SDMError
from sdm.shapes import Cochlea
from sdm.shapes.sampling import uniform


def cochleas(count: int, device: str = "cpu") -> ShapeSet:
    family = Cochlea(800)
    return ShapeSet([family.mesh(t) for t in family.sample(count, device="cpu")], device)


def ball(radius: float = 1.0, centre: tuple[float, float, float] = (0, 0, 0)) -> TriangleMesh:
    made = trimesh.creation.icosphere(3, radius)
    return TriangleMesh(made.vertices + centre, made.faces, "ball")


def test_values_are_the_engines_for_every_shape_of_a_large_set(device: str) -> None:
    """65 shapes lie in five staggered layers; each is measured as if it were alone."""
    shapes = cochleas(65, device)
    every = torch.arange(len(shapes), device=device)
    points, values = shapes.sample(every, 200)
    for shape in range(0, 65, 4):
        alone = signed_distance(shapes.mesh(shape), points[shape], device=device)
        assert torch.allclose(values[shape], alone, atol=1e-7, rtol=2e-7)


def test_points_at_the_reach_are_measured_to_their_own_shape() -> None:
    shapes = cochleas(65)
    corners = 1.5 * torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3)
    every = torch.arange(len(shapes))
    values = shapes.signed_distance(every, corners.expand(len(shapes), 8, 3))
    for shape in range(len(shapes)):
        assert torch.allclose(values[shape], signed_distance(shapes.mesh(shape), corners, device="cpu"), atol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 9, 65, 500])
def test_each_shape_is_alone_in_its_part_of_the_cube(count: int) -> None:
    places = _places(count)
    *low, edge = _cube_around(places)
    parts = edge / (STEP / 2)
    assert parts == 2 ** round(math.log2(parts))
    corners = places[:, None] + 0.999 * REACH * torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3)
    part = ((corners - torch.tensor(low)) / (STEP / 2)).floor()
    assert (part == part[:, :1]).all()
    assert part.min() >= 0
    assert part.max() < parts
    assert len({tuple(each) for each in part[:, 0].tolist()}) == count


def test_points_that_another_shape_could_be_nearer_to_have_no_value() -> None:
    shapes = ShapeSet([ball()], "cpu")
    far = torch.tensor([[[0.0, 0, 0], [1.6, 0, 0], [float("nan"), 0, 0]]])
    assert shapes.signed_distance(torch.tensor([0]), far)[0].isnan().tolist() == [False, True, True]


def test_the_scene_rounds_a_shape_by_no_more_than_it_says() -> None:
    family = Cochlea(800)
    meshes = [family.mesh(t) for t in family.sample(65, device="cpu")]
    shapes = ShapeSet(meshes, "cpu")
    for number in (0, 40, 64):
        unit = shapes.spheres[number].to_unit(meshes[number].vertices)
        assert (shapes.mesh(number).vertices - unit).abs().max() <= 2.0**-18


def test_a_sample_depends_on_seed_step_and_shape_alone() -> None:
    shapes = cochleas(5)
    together = shapes.sample(torch.tensor([4, 0, 2]), 100, seed=7, step=3)
    alone = shapes.sample(torch.tensor([2]), 100, seed=7, step=3)
    assert torch.equal(together.points[2], alone.points[0])
    assert torch.equal(together.values[2], alone.values[0])
    for seed, step in ((8, 3), (7, 4)):
        assert not torch.equal(shapes.sample(torch.tensor([2]), 100, seed=seed, step=step).points, alone.points)
    assert not torch.equal(together.points[0], together.points[1])


def test_samples_are_where_their_numbers_say() -> None:
    """The same samples from the same numbers in [0,1), drawn with torch."""
    shapes, count, seed, step = cochleas(3), 400, 2**40 + 9, 5
    chosen = torch.tensor([2, 0])
    near = round(0.94 * count)
    points = shapes.sample(chosen, count, seed=seed, step=step).points
    for row, shape in enumerate(chosen.tolist()):
        number = (step * len(shapes) + shape) * count + torch.arange(count)
        u = uniform(derive_seed(seed, "samples of shapes", count), number, 8).double()
        mesh = shapes.mesh(shape)
        corners = mesh.vertices[mesh.faces.long()].double()
        areas = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1).cumsum(0)
        place = (torch.arange(near) + u[:near, 0]) / near * areas[-1]
        # Where the place is within rounding of a face's end either face will do.
        clear = (areas[None] - place[:, None]).abs().amin(1) > 1e-9 * areas[-1]
        a, b, c = corners[torch.searchsorted(areas, place, right=True).clamp(max=len(areas) - 1)].unbind(1)
        root, share = u[:near, 1, None].sqrt(), u[:near, 2, None]
        at = (1 - root) * a + root * (1 - share) * b + root * share * c
        length, angle = (-2 * (1 - u[:near, 3:7:2]).log()).sqrt(), 2 * torch.pi * u[:near, 4:7:2]
        normal = torch.cat([length * angle.cos(), (length * angle.sin())[:, :1]], 1)
        at = (at + normal * torch.tensor([0.005**0.5, 0.0005**0.5]).repeat(near // 2)[:, None]).clamp(-1.5, 1.5)
        assert (points[row, :near] - at)[clear].abs().max() < 1e-5
        assert (points[row, near:] - (2 * u[near:, :3] - 1)).abs().max() < 1e-5


def test_shares_and_variances_are_those_of_the_paper() -> None:
    """On a large flat box the distance from the surface is the normal offset along one axis."""
    slab = trimesh.creation.box((2, 2, 1.5))
    shapes = ShapeSet([TriangleMesh(slab.vertices, slab.faces)], "cpu")
    count = 40_000
    points, values = (part[0] for part in shapes.sample(torch.tensor([0]), count))
    near = round(0.94 * count)
    tight, wide = values[1:near:2], values[0:near:2]
    # A normal's quartiles are 0.6745 deviations away; edges and the far side blur that a little.
    assert tight.abs().median().item() == pytest.approx(0.6745 * 0.0005**0.5, rel=0.05)
    assert wide.abs().median().item() == pytest.approx(0.6745 * 0.005**0.5, rel=0.12)
    box = points[near:]
    assert box.abs().max() <= 1
    assert box.mean(0).abs().max() < 0.05
    assert box.std(0).sub(3**-0.5).abs().max() < 0.03


def test_other_shares_can_be_had() -> None:
    shapes = ShapeSet([ball()], "cpu", distribution=SampleDistribution(near=1.0, variances=(0.0, 0.0)))
    values = shapes.sample(torch.tensor([0]), 500).values
    assert values.abs().max() < 1e-6


def test_surface_points_are_spread_by_area_in_every_shape_of_a_set() -> None:
    """Two balls of very different size: neither borrows the other's triangles."""
    meshes = [ball(0.01), ball(100.0, (5, 5, 5))]
    shapes = ShapeSet(meshes, "cpu", distribution=SampleDistribution(near=1.0, variances=(0.0, 0.0)))
    points = shapes.sample(torch.tensor([0, 1]), 8000).points
    radius = points.norm(dim=2)
    assert (radius - 1 / 1.03).abs().max() < 0.02
    assert points.mean(1).abs().max() < 0.01


def test_bad_input_is_said() -> None:
    with pytest.raises(MeshError, match="no meshes to sample"):
        ShapeSet([], "cpu")
    box = trimesh.creation.box((1, 1, 1))
    open_box = TriangleMesh(box.vertices, box.faces[:-1], "lidless")
    with pytest.raises(MeshError, match="lidless is not closed"):
        ShapeSet([ball(), open_box], "cpu")
    with pytest.raises(MeshError, match="ball reaches out of its unit sphere"):
        ShapeSet([ball()], "cpu", spheres=[UnitSphere((0, 0, 0), 0.5)])
    with pytest.raises(MeshError, match="1 spheres were given for 2 meshes"):
        ShapeSet([ball(), ball()], "cpu", spheres=[UnitSphere((0, 0, 0), 2)])
    # Beyond that box a sample may be nearer to another shape of the scene.
    for box in (1.51, 0.0, math.nan):
        with pytest.raises(SDMError, match=r"box is above 0 and at most 1.5"):
            SampleDistribution(box=box)
    with pytest.raises(SDMError, match="variances are not negative"):
        SampleDistribution(variances=(0.005, math.nan))
    assert SampleDistribution(box=1.5).box == 1.5


def test_a_mesh_that_is_inside_out_is_turned() -> None:
    shapes = ShapeSet([ball(2.0).flipped(), ball()], "cpu")
    centre, outside = shapes.signed_distance(torch.tensor([0, 1]), torch.tensor([[[0.0, 0, 0], [1.2, 0, 0]]] * 2)).T
    assert (centre < 0).all()
    assert (outside > 0).all()
    assert torch.equal(shapes.mesh(1).faces, ball().faces)
    assert torch.equal(shapes.mesh(0).faces, ball().faces)


def test_shapes_that_are_not_there_are_refused_on_a_cpu_and_read_no_other_memory(device: str) -> None:
    shapes = ShapeSet([ball(), ball(2.0)], device)
    asked, points = torch.tensor([-1, 5], device=device), torch.zeros(2, 1, 3, device=device)
    if device == "cpu":
        for call in (lambda: shapes.sample(asked[1:], 5), lambda: shapes.signed_distance(asked[1:], points[1:])):
            with pytest.raises(SDMError, match="shape 5 is not there: the set has 2, numbered from 0"):
                call()
        with pytest.raises(SDMError, match="shape -1 is not there"):
            shapes.sample(asked, 5)
    else:
        there = torch.tensor([0, 1], device=device)
        assert torch.equal(shapes.sample(asked, 5).values, shapes.sample(there, 5).values)
        assert torch.equal(shapes.signed_distance(asked, points), shapes.signed_distance(there, points))


def test_vertices_that_no_face_uses_are_no_part_of_a_shape() -> None:
    stray = torch.tensor([[50.0, 50, 50]])
    with_stray = TriangleMesh(torch.cat([ball().vertices, stray]), ball().faces, "stray")
    found, wanted = (ShapeSet([mesh], "cpu").sample(torch.tensor([0]), 200) for mesh in (with_stray, ball()))
    assert torch.equal(found.points, wanted.points)
    assert torch.equal(found.values, wanted.values)


def test_points_of_a_surface_are_on_it_and_spread_by_area() -> None:
    box = trimesh.creation.box((1, 2, 4))
    mesh = TriangleMesh(box.vertices, box.faces)
    points, normals = surface_points(mesh, 30_000, seed=3)
    assert signed_distance(mesh, points).abs().max() < 1e-6
    share = [float((normals[:, axis].abs() > 0.5).float().mean()) for axis in range(3)]
    assert share == pytest.approx([8 / 14, 4 / 14, 2 / 14], abs=0.015)
    outside = signed_distance(mesh, points + 0.1 * normals)
    assert (outside > 0).all()
    assert torch.equal(points, surface_points(mesh, 30_000, seed=3)[0])


def test_a_surface_without_area_is_said() -> None:
    with pytest.raises(MeshError, match="every triangle of mesh has zero area"):
        surface_points(TriangleMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]), 10)
