"""A folder of meshes as a family: which files, which layout, and a warp that never folds."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.bench.common.meshes import sphere
from sdm.errors import MeshError
from sdm.shapes import Cochlea, Cuboid, Ellipsoid, MeshFolder, mesh_folder


def solid(family, scale: float = 1.0) -> sdm.TriangleMesh:
    mesh = family.mesh(family.from_unit(torch.full((1, len(family.parameters)), 0.4)))
    return sdm.TriangleMesh(scale * mesh.vertices + 3, mesh.faces, family.name)


def meshes() -> list[sdm.TriangleMesh]:
    return [solid(Cuboid(triangles=300)), solid(Ellipsoid(triangles=1200), 5.0)]


@pytest.fixture
def folder(tmp_path):
    for name, mesh in zip(("b.ply", "a.stl"), meshes(), strict=True):
        trimesh.Trimesh(*mesh.numpy(), process=False).export(tmp_path / name)
    (tmp_path / "notes.txt").write_text("not a mesh")
    return tmp_path


def test_reads_a_folder_in_order_of_names(folder):
    family = MeshFolder(folder)
    assert [len(m) for m in family.meshes] == [1200, 300]
    assert family.rejected == ()
    assert len(family.parameters) == 26
    assert len(family.faces) == 1500


def test_reads_folders_in_it_and_every_format(folder):
    (folder / "1234" / "models").mkdir(parents=True)
    trimesh.Trimesh(*solid(Cuboid(triangles=700)).numpy(), process=False).export(folder / "1234" / "models" / "a.glb")
    (folder / "1234" / "bad.off").write_bytes(b"nonsense")
    family = MeshFolder(folder, skip_bad=True)
    assert [name for name, _ in family.rejected] == ["1234/bad.off"]
    assert len(family.meshes) == 3


def test_a_bad_file_is_named_with_its_reason(folder):
    box = trimesh.creation.box()
    box.update_faces(np.arange(10))
    box.export(folder / "open.ply")
    (folder / "broken.stl").write_bytes(b"nonsense")
    with pytest.raises(MeshError, match=r"broken.stl cannot be used: .* 1 more.*skip_bad"):
        MeshFolder(folder)
    family = MeshFolder(folder, skip_bad=True)
    assert len(family.meshes) == 2
    assert [name for name, _ in family.rejected] == ["broken.stl", "open.ply"]
    assert "holes" in family.rejected[1][1]
    assert len(MeshFolder(meshes(), open_meshes="keep").meshes) == 2


def joined(*parts: sdm.TriangleMesh) -> sdm.TriangleMesh:
    first = [0, *np.cumsum([len(m.vertices) for m in parts])]
    faces = [m.faces + int(n) for m, n in zip(parts, first, strict=False)]
    return sdm.TriangleMesh(torch.cat([m.vertices for m in parts]), torch.cat(faces), "joined")


def moved(mesh: sdm.TriangleMesh, shift: float, scale: float = 1.0) -> sdm.TriangleMesh:
    return sdm.TriangleMesh(scale * (mesh.vertices - 3) + 3 + shift, mesh.faces, mesh.name)


def with_a_turned_face(mesh: sdm.TriangleMesh) -> sdm.TriangleMesh:
    faces = mesh.faces.clone()
    faces[0] = faces[0].flip(0)
    return sdm.TriangleMesh(mesh.vertices, faces)


def sheet(mesh: sdm.TriangleMesh) -> sdm.TriangleMesh:
    return sdm.TriangleMesh(mesh.vertices, torch.cat([mesh.faces[:1], mesh.faces[:1].flip(1)]))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda m: sdm.TriangleMesh(m.vertices, m.faces[1:]), "holes (3 edges of one face only)"),
        (sheet, "encloses no volume"),
        (lambda m: moved(m, 0.0, 0.0), "size zero"),
    ],
    ids=["hole", "sheet", "point"],
)
def test_triage_says_what_is_wrong(change, reason):
    good = meshes()[0]
    family = MeshFolder([good, change(good)], skip_bad=True)
    assert len(family.meshes) == 1
    ((_, said),) = family.rejected
    assert reason in said


def test_cavities_and_what_can_be_turned_outward_are_fine():
    good = meshes()[0]
    hollow = joined(good, moved(good, 0.0, 0.5).flipped())
    parts = joined(good, moved(good, 9.0).flipped(), moved(good, 20.0))
    family = MeshFolder([hollow, hollow.flipped(), good.flipped(), with_a_turned_face(good), parts])
    assert family.rejected == ()
    for mesh in family.meshes:
        assert trimesh.Trimesh(*mesh.numpy(), process=False).volume > 0


def test_what_no_winding_number_signs_is_used_where_another_sign_is_wanted():
    good = meshes()[0]
    walls = sdm.TriangleMesh(good.vertices, torch.cat([good.faces, good.faces.flip(1)]), "walls")
    odd = [good, walls, sdm.TriangleMesh(good.vertices, good.faces[1:]), good.flipped()]
    for sign in ("flood", "none"):
        assert len(MeshFolder(odd, sign=sign, orient="keep").meshes) == 4
    assert len(MeshFolder(odd, sign="flood", orient="keep", open_meshes="reject", skip_bad=True).meshes) == 3
    assert len(MeshFolder(odd, orient="keep", skip_bad=True).meshes) == 1
    with pytest.raises(MeshError, match=r"no mesh to use: walls cannot be used: .*sign='flood' \(and 1 more\)$"):
        MeshFolder([walls, odd[2]], skip_bad=True)


def test_warped_meshes_do_not_meet_themselves():
    cgal = pytest.importorskip("igl.copyleft.cgal", reason="libigl, which finds self-intersections, is not installed")
    family = MeshFolder([Cochlea(2_000).mesh([3.6, 0.4, 0.14, -0.2]), *meshes()], warp=0.95)
    corners = torch.randint(0, 2, (6, 26), generator=torch.Generator().manual_seed(3)).float()
    corners[:, 0] = torch.tensor([0.1, 0.1, 0.5, 0.5, 0.9, 0.9])
    theta = torch.cat([family.from_unit(corners), family.sample(12, seed=8, device="cpu")])
    for group in family.groups(theta):
        faces = group.faces.numpy().astype(np.int64)
        for vertices in group.vertices:
            found = cgal.remesh_self_intersections(vertices.double().numpy(), faces, detect_only=True)
            assert len(found[2]) == 0


def test_an_empty_folder(tmp_path):
    with pytest.raises(MeshError, match="no mesh to use"):
        MeshFolder(tmp_path)
    with pytest.raises(MeshError, match="is not a folder"):
        MeshFolder(tmp_path / "missing")


def test_an_inside_out_mesh_is_turned():
    family = MeshFolder([meshes()[0].flipped()])
    vertices, faces = family.mesh(family.sample(1, device="cpu")).numpy()
    assert trimesh.Trimesh(vertices, faces, process=False).volume > 0


def test_without_changes_each_mesh_is_itself():
    given = meshes()
    family = MeshFolder(given, normalize=False, rotation=0, scale=(1, 1), shift=0, warp=0)
    theta = family.sample(20, device="cpu")
    for group in family.groups(theta):
        expected = given[int(theta[group.rows[0], 0])]
        torch.testing.assert_close(group.vertices[0], expected.vertices, atol=2e-6, rtol=0)
        assert torch.equal(group.faces, expected.faces)


def test_normalized_meshes_fit_the_unit_box():
    family = MeshFolder(meshes(), rotation=0, scale=(1, 1), shift=0, warp=0)
    for group in family.groups(family.sample(20, device="cpu")):
        assert float(group.vertices.abs().max()) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("rotation", [None, 0.0, 30.0])
@pytest.mark.parametrize("warp", [0.0, 0.95])
def test_bounds_hold_every_shape_and_little_more(rotation, warp):
    family = MeshFolder(meshes(), normalize=False, rotation=rotation, warp=warp, scale=(0.5, 1.5))
    low, high = family.bounds()
    random = torch.Generator().manual_seed(4)
    unit = torch.randint(0, 2, (12_000, 26), generator=random).float()
    # Uniform rotations do not turn furthest at corners of the box.
    unit[:, 2:5] = torch.rand((12_000, 3), generator=random)
    # Of all warps those that move some point the same way by all of their waves.
    to, by = (torch.randint(0, 2, (12_000, *n), generator=random) * 2.0 - 1 for n in ((3, 1), (2, 1, 3)))
    unit[:, 8:] = (to[:, None] * by).flatten(1) / 2 + 0.5
    least, most = torch.full((3,), torch.inf), torch.full((3,), -torch.inf)
    for group in family.groups(family.from_unit(unit)):
        least = torch.minimum(least, group.vertices.amin((0, 1)))
        most = torch.maximum(most, group.vertices.amax((0, 1)))
    assert bool((least >= low).all())
    assert bool((most <= high).all())
    assert bool((most - least >= 0.9 * (high - low)).all())


def test_the_grid_holds_a_large_mesh_among_many(monkeypatch):
    small = trimesh.creation.icosahedron()
    one = sdm.TriangleMesh(small.vertices, small.faces)
    large = sdm.TriangleMesh(10 * one.vertices, one.faces)
    # All are closed and face outward, which takes milliseconds a mesh to find out.
    monkeypatch.setattr(mesh_folder, "reason_to_reject", lambda mesh, **_: None)
    family = MeshFolder([large if n == 7 else one for n in range(1200)], normalize=False, orient="keep")
    low, high = family.bounds()
    theta = family.sample(200, device="cpu")
    theta[:, 0] = 7.5
    found = torch.cat([group.vertices for group in family.groups(theta)])
    assert bool(((found >= low) & (found <= high)).all())


def test_both_layouts_are_the_same_surface():
    family = MeshFolder(meshes())
    theta = family.sample(6, seed=4, device="cpu")
    together = family.vertices(theta)
    assert set(theta[:, 0].long().tolist()) == {0, 1}
    seen = []
    for group in family.groups(theta, theta.clone()):
        for row, vertices in zip(group.rows.tolist(), group.vertices, strict=True):
            seen.append(row)
            corners = together[row][family.faces.long()]
            real = (corners != corners[:, :1]).any(2).any(1)
            assert torch.equal(corners[real], vertices[group.faces.long()])
            # What is left is one point, a vertex of the mesh.
            points = torch.unique(corners[~real].reshape(-1, 3), dim=0)
            assert points.shape == (1, 3)
            assert (vertices == points).all(1).any()
    assert sorted(seen) == list(range(6))


def test_both_layouts_have_the_same_distances():
    family = MeshFolder(meshes())
    theta = family.sample(3, seed=4, device="cpu")
    grid = family.grid(10)
    together = sdm.signed_distance_maps(family.vertices(theta), family.faces, grid, device="cpu")
    for group in family.groups(theta):
        alone = sdm.signed_distance_maps(group.vertices, group.faces, grid, device="cpu")
        torch.testing.assert_close(together[group.rows], alone, atol=2e-6, rtol=0)


@pytest.mark.parametrize("warp", [0.3, 0.95])
def test_the_warp_is_bounded(warp):
    # The worst coefficients of the box: neighbouring points never come closer than the bound allows.
    family = MeshFolder([solid(Ellipsoid(triangles=1200))], rotation=0, scale=(1, 1), shift=0, warp=warp)
    unit = torch.randint(0, 2, (64, 26), generator=torch.Generator().manual_seed(1)).float()
    unit[:, 0] = 0.5
    still = MeshFolder(family.meshes, rotation=0, scale=(1, 1), shift=0, warp=0)
    rest = still.vertices(still.sample(1, device="cpu"))
    moved = family.vertices(family.from_unit(unit))
    edges = family.faces[:, :2].long()
    before = (rest[:, edges[:, 0]] - rest[:, edges[:, 1]]).norm(dim=2)
    change = ((moved - rest)[:, edges[:, 0]] - (moved - rest)[:, edges[:, 1]]).norm(dim=2)
    assert float((change / before).max()) <= warp * 1.001
    assert float((change / before).max()) > 0.4 * warp


def test_small_rotations_stay_small():
    family = MeshFolder([solid(Cuboid(triangles=12))], rotation=10, scale=(1, 1), shift=0, warp=0)
    rest = family.vertices(family.from_unit(torch.full((1, 26), 0.5)))
    turned = family.vertices(family.sample(200, device="cpu"))
    cosine = torch.nn.functional.cosine_similarity(rest, turned, dim=2)
    assert float(torch.rad2deg(cosine.clamp(max=1).acos()).max()) <= 10.01
    norm = turned.norm(dim=2)
    torch.testing.assert_close(norm, rest.norm(dim=2).expand_as(norm))


@pytest.mark.parametrize("rotation", [None, 30.0])
def test_gradient_is_the_finite_difference(rotation):
    family = MeshFolder(meshes(), rotation=rotation)
    theta = family.from_unit(0.1 + 0.8 * family.to_unit(family.sample(4, seed=6, device="cpu")))
    theta[:, 0] = torch.tensor([0.5, 1.5, 0.5, 1.5])
    weights = torch.randn(family.vertices(theta).shape, generator=torch.Generator().manual_seed(7))
    theta.requires_grad_()
    (family.vertices(theta) * weights).sum().backward()
    for column in range(1, theta.shape[1]):
        ends = theta.detach().clone(), theta.detach().clone()
        ends[0][:, column] -= 2e-3
        ends[1][:, column] += 2e-3
        low, high = ((family.vertices(e).double() * weights).sum((1, 2)) for e in ends)
        slope = (high - low) / (ends[1] - ends[0])[:, column].double()
        assert theta.grad is not None
        torch.testing.assert_close(slope.float(), theta.grad[:, column], atol=0.3, rtol=1e-2)


@pytest.mark.parametrize(
    "arguments",
    [{"warp": 1.0}, {"scale": (0, 1)}, {"shift": -1}, {"rotation": 200}, {"open_meshes": "maybe"}, {"orient": "up"}],
)
def test_senseless_options(arguments):
    with pytest.raises(MeshError):
        MeshFolder(meshes(), **arguments)


def test_meshes_are_turned_as_one_says():
    vertices, faces = sphere(10)
    turned = np.random.default_rng(0).random((len(faces), 1)) < 0.4
    mixed = sdm.TriangleMesh(vertices, np.where(turned, faces[:, ::-1], faces), "mixed")
    for orient, expected in (
        ("auto", sdm.inspect.orient_outward(mixed)),
        ("parts", sdm.orient_faces(mixed, "cpu")),
        ("keep", mixed),
    ):
        (found,) = MeshFolder([mixed], orient=orient, open_meshes="keep").meshes
        assert torch.equal(found.faces, expected.faces), orient
    # Of these nobody can tell the inside.
    with pytest.raises(MeshError, match="faces disagree which side is out"):
        MeshFolder([mixed], orient="keep")
    assert len(MeshFolder([mixed], orient="parts").meshes) == 1


def test_faces_that_are_there_several_times_do_not_disagree():
    """A ball with some of its faces twice has no rim, and no edge along which faces disagree."""
    ball = trimesh.creation.icosphere(2)
    mesh = sdm.TriangleMesh(ball.vertices, np.concatenate([ball.faces, ball.faces[:37]]))
    with pytest.raises(MeshError, match=r"65 of its edges have more than two faces, and 37 faces are copies of others"):
        MeshFolder([mesh])
    assert len(MeshFolder([mesh], open_meshes="keep").meshes) == 1
