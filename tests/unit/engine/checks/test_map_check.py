from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest
import trimesh

import sdm
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.errors import SDMWarning
from sdm.inspect.problems import NOTHING_INSIDE

BALL = trimesh.creation.icosphere(2, radius=20)
AT = np.array([-40.0, -30, 50])
# As of an image in RAS.
GRID = Grid((-72, -62, 18), (4, 4, 4), (17, 17, 17))


def ball(scale=(1.0, 1.0, 1.0), faces=BALL.faces) -> TriangleMesh:
    out = faces if np.prod(scale) > 0 else faces[:, ::-1]
    return TriangleMesh(((BALL.vertices + AT) * scale).astype(np.float32), out, "ball")


def two(second, *, apart: float = 50.0) -> TriangleMesh:
    vertices = np.concatenate([BALL.vertices, BALL.vertices + np.array([apart, 0, 0])])
    return TriangleMesh(vertices, np.concatenate([BALL.faces, second + len(BALL.vertices)]))


FLIP = np.random.default_rng(0).random(len(BALL.faces)) < 0.5
CASES = {
    "inside out": (ball(faces=BALL.faces[:, ::-1]), GRID, ["inside out", "closed", 'orient="auto"', "--orient auto"]),
    "open, inside out": (ball(faces=BALL.faces[1:, ::-1]), GRID, ["inside out", "look inward", 'orient="auto"']),
    "LPS": (ball((-1, -1, 1)), GRID, ["no voxel is inside", "LPS", "--mesh-space lps", "(20, 10, 30) to (60, 50, 70)"]),
    "metres": (ball((1e-3,) * 3), GRID, ["no voxel is inside", "metres", "--scale 1000"]),
    "metres at the origin": (
        TriangleMesh(BALL.vertices / 1000, BALL.faces), Grid((-30,) * 3, (4,) * 3, (16,) * 3), ["metres", "a few"]
    ),
    "millimetres": (
        ball(), Grid(np.array(GRID.origin) / 1000, (0.004,) * 3, GRID.shape), ["millimetres", "--scale 0.001"]
    ),
    "wholly outside": (ball(), Grid((500, 0, 0), (4, 4, 4), (9, 9, 9)), ["outside the grid's", "(500, 0, 0) to (532"]),
    "flipped at random": (
        ball(faces=np.where(FLIP[:, None], BALL.faces[:, ::-1], BALL.faces)), GRID, ["disagree", "not to be trusted"]
    ),
    "one of two parts": (two(BALL.faces[:, ::-1]), Grid((-30, -30, -30), (5, 5, 5), (24, 13, 13)), ["1 of 2 comp"]),
    "no volume": (
        ball(faces=np.concatenate([BALL.faces[:9], BALL.faces[:9, ::-1]])), GRID, ["encloses no volume", 'sign="flood"']
    ),
    "millimetres around the whole grid": (
        TriangleMesh(50 * BALL.vertices, BALL.faces), Grid((-0.8,) * 3, (0.2,) * 3, (9,) * 3), ["every voxel", "0.001"]
    ),
    "axes as of an array": (
        TriangleMesh((BALL.vertices + AT)[:, ::-1].copy(), BALL.faces), GRID, ["x and z swapped", "inside out"]
    ),
    "too far for float32": (
        TriangleMesh(BALL.vertices + 1e8, BALL.faces), Grid((1e8 - 24,) * 3, (4,) * 3, (13,) * 3), ["steps of 8 in"]
    ),
    "thinner than a voxel": (
        TriangleMesh(BALL.vertices * [1, 1, 0.01] + [0, 0, 1], BALL.faces), Grid((-24,) * 3, (4,) * 3, (13,) * 3),
        ["0.4 thick along z", "a finer grid"],
    ),
    "between voxels": (
        TriangleMesh(BALL.vertices / 200 + 2, BALL.faces), Grid((0,) * 3, (4,) * 3, (9,) * 3), ["a finer grid"]
    ),
}  # fmt: skip


def found_by(compute) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        compute()
    assert all(issubclass(one.category, SDMWarning) for one in caught)
    assert all(one.filename == __file__ for one in caught)
    return [str(one.message) for one in caught]


@pytest.mark.parametrize("name", CASES)
def test_what_was_probably_not_meant_is_said_once(name):
    mesh, grid, words = CASES[name]
    messages = found_by(lambda: sdm.signed_distance_map(mesh, grid, device="cpu"))
    assert len(messages) == 1
    assert all(word in messages[0] for word in words)
    index = sdm.MeshIndex(mesh, "cpu")
    assert found_by(lambda: [index.signed_distance_map(grid) for _ in range(2)]) == messages


def test_a_closed_mesh_without_a_gap_is_called_thin_and_nothing_is_said_of_gaps():
    shell = trimesh.creation.annulus(r_min=9.999, r_max=10, height=12)
    grid = Grid((-14.2, -14.3, -9.1), (1, 1, 1), (29, 29, 19))
    walls, lid = TriangleMesh(shell.vertices, shell.faces, "walls"), CASES["thinner than a voxel"]
    for mesh, at, sign, words in (
        (walls, grid, "winding", ["although the mesh is closed: it is thinner than the voxels, 1; use a finer grid"]),
        (walls, grid, "flood", ["thinner than the voxels, 1;", "--hole-size"]),
        (*lid[:2], "flood", ["0.4 thick along z", "a finer grid"]),
    ):
        (said,) = found_by(
            lambda mesh=mesh, at=at, sign=sign: sdm.signed_distance_map(mesh, at, device="cpu", sign=sign)
        )
        assert all(word in said for word in words)
        assert "gaps" not in said
        assert "--orient" not in said
    # What is said to help does.
    assert found_by(lambda: sdm.signed_distance_map(walls, grid, device="cpu", sign="flood", hole_size=25)) == []
    doubled = TriangleMesh(BALL.vertices, [*BALL.faces[9:], *BALL.faces[9:, ::-1]])
    assert (
        "through gaps"
        in found_by(
            lambda: sdm.signed_distance_map(doubled, Grid((-24,) * 3, (2,) * 3, (25,) * 3), device="cpu", sign="flood")
        )[0]
    )


def test_of_a_list_each_mesh_is_named_by_its_number():
    mesh, grid, _ = CASES["inside out"]
    (alone,) = found_by(lambda: sdm.signed_distance_map(mesh, grid, device="cpu"))
    gradients = TriangleMesh(mesh.vertices.clone().requires_grad_(), mesh.faces)
    meshes = [mesh, ball(), gradients, mesh]
    assert found_by(lambda: sdm.signed_distance_maps(meshes, grid, device="cpu")) == [
        f"mesh 0: {alone}",
        f"mesh 3: {alone}",
    ]
    # One that is made by itself is named alike.
    assert found_by(lambda: list(sdm.signed_distance_maps(iter(meshes[:2]), grid, device="cpu", max_bytes=1))) == [
        f"mesh 0: {alone}"
    ]
    assert found_by(lambda: sdm.signed_distance_maps(meshes, grid, device="cpu", orient="auto")) == []
    assert found_by(lambda: sdm.signed_distance_maps(meshes, grid, device="cpu", sign="none")) == []


@pytest.mark.parametrize("name", CASES)
def test_nothing_is_said_of_gradients_or_where_it_is_turned_off(name):
    mesh, grid, _ = CASES[name]
    moving = TriangleMesh(mesh.vertices.clone().requires_grad_(), mesh.faces)
    assert found_by(lambda: list(sdm.MeshIndex(mesh, "cpu", warn=False).slabs(grid))) == []
    assert found_by(lambda: sdm.signed_distance_maps(moving.vertices[None], mesh.faces, grid, device="cpu")) == []
    assert found_by(lambda: sdm.MeshIndex(mesh, "cpu", warn=False).signed_distance_map(grid)) == []
    assert found_by(lambda: sdm.signed_distance_map(moving, grid, device="cpu")) == []


@pytest.mark.parametrize("name", ["inside out", "open, inside out", "flipped at random", "one of two parts"])
def test_orient_auto_mends_it(name):
    mesh, grid, _ = CASES[name]
    assert found_by(lambda: sdm.signed_distance_map(mesh, grid, device="cpu", orient="auto")) == []
    field = sdm.signed_distance_map(mesh, grid, device="cpu", orient="auto")
    volume = field.inside_voxels * np.prod(grid.spacing)
    balls = 2 if name == "one of two parts" else 1
    assert volume == pytest.approx(balls * BALL.volume, rel=0.1)


SHAPES = {
    "box": {},
    "cylinder": {"radius": 1, "height": 2},
    "capsule": {},
    "cone": {"radius": 1, "height": 2},
    "icosphere": {},
    "torus": {"major_radius": 2, "minor_radius": 0.5},
    "annulus": {"r_min": 1, "r_max": 2, "height": 1},
}


@pytest.mark.parametrize("shape", SHAPES)
def test_convex_and_round_shapes_raise_no_alarm(shape):
    made = getattr(trimesh.creation, shape)(**SHAPES[shape])
    mesh = TriangleMesh(made.vertices, made.faces)
    low, high = mesh.bounds
    size = high - low
    grids = [
        Grid.around(mesh, resolution=2),
        Grid.around(mesh, resolution=9),
        Grid.around(mesh, resolution=9, margin=3.0),
        # Inside it, across its border, a plane through it.
        Grid((low + high) / 2 - 0.05 * size, size / 50, (5, 5, 5)),
        Grid(low - 0.5 * size, size / 10, (8, 8, 8)),
        Grid(low, size / 10, (1, 11, 11)),
    ]
    for grid in grids:
        said = found_by(lambda grid=grid: sdm.signed_distance_map(mesh, grid, device="cpu"))
        assert said == [] or (size.min() < max(grid.spacing) and "thick along z" in said[0])


def test_sheets_cavities_and_overlaps_raise_no_alarm():
    hemisphere = BALL.faces[(BALL.vertices[BALL.faces][:, :, 2] < 1).all(1)]
    inner = np.concatenate([BALL.faces, BALL.faces[:, ::-1] + len(BALL.vertices)])
    vertices = np.concatenate([BALL.vertices, BALL.vertices / 2])
    rng = np.random.default_rng(1)
    meshes = [
        TriangleMesh(BALL.vertices, hemisphere),
        TriangleMesh(BALL.vertices, hemisphere[:, ::-1]),
        TriangleMesh(BALL.vertices, BALL.faces[:1]),
        TriangleMesh(BALL.vertices, BALL.faces[1:]),
        TriangleMesh(vertices, inner),
        two(BALL.faces),
        two(BALL.faces, apart=10),
        TriangleMesh(rng.normal(size=(60, 3)), np.arange(60).reshape(-1, 3)),
        TriangleMesh(BALL.vertices, np.concatenate([BALL.faces, BALL.faces])),
        TriangleMesh(BALL.vertices, np.concatenate([BALL.faces[:1]] * 5)),
    ]
    for mesh in meshes:
        assert found_by(lambda mesh=mesh: sdm.signed_distance_map(mesh, 9, device="cpu")) == []


def test_real_meshes_raise_no_alarm(data_dir):
    files = sorted((data_dir / "meshes").glob("*.ply"))
    assert files
    for path in files:
        mesh = sdm.load_mesh(path)
        messages = found_by(lambda mesh=mesh: sdm.signed_distance_map(mesh, 12, device="cpu"))
        wanted = [f"chair_model.ply: {NOTHING_INSIDE}"]
        assert messages == (wanted if path.name == "chair_model.ply" else [])


def test_a_map_that_waits_to_be_read_warns_then():
    mesh, grid, _ = CASES["inside out"]

    field = sdm.MeshIndex(mesh, "cpu", warn=False).signed_distance_map(grid)
    said = []
    field.__dict__["_pending"] = lambda *given: said.append(given)
    assert said == []
    again = pickle.loads(pickle.dumps(field))
    assert again.inside_voxels == 0
    assert said == []
    field.numpy()
    field.numpy()
    assert said == [(grid, 0)]
    for read in (lambda f: f.inside_voxels, lambda f: f.cpu(), np.asarray):
        field.__dict__["_pending"] = lambda *given: said.append(given)
        said.clear()
        field.__dict__.pop("inside_voxels", None)
        read(field)
        assert said == [(grid, 0)]


def test_inside_voxels_are_those_with_negative_values():
    field = sdm.signed_distance_map(ball(), GRID, device="cpu")
    assert field.inside_voxels == (field.numpy() < 0).sum() > 0
    assert sdm.SDM(np.array([[[-1.0, 0.0, -0.0, 2.0]]]), Grid((0,) * 3, (1,) * 3, (1, 1, 4))).inside_voxels == 1


def test_an_index_says_it_of_the_vertices_it_has():
    index = sdm.MeshIndex(ball(), "cpu")
    assert found_by(lambda: index.signed_distance_map(GRID)) == []
    index.update(ball((-1, -1, 1)).vertices)
    messages = found_by(lambda: index.signed_distance_map(GRID))
    assert len(messages) == 1
    assert "LPS" in messages[0]
