from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh

from sdm.core.demo_mesh import demo_mesh
from sdm.errors import FormatError, MeshError
from sdm.inspect import inspect_mesh
from sdm.io import load_mesh, mesh_files
from sdm.io.meshes.write import write_ply

BOX = trimesh.creation.box((1, 2, 3))


@pytest.mark.parametrize("ending", ["stl", "stl_ascii", "ply", "obj", "off", "glb", "gltf"])
def test_every_usual_format_gives_the_same_closed_box(ending, tmp_path):
    path = tmp_path / f"box.{ending}"
    if ending == "gltf":
        parts: Any = BOX.export(file_type="gltf")
        for name, content in parts.items():
            (tmp_path / name).write_bytes(content)
        path = tmp_path / "model.gltf"
    else:
        BOX.export(path)
    mesh = load_mesh(path)
    assert mesh.name == path.name
    report = inspect_mesh(mesh)
    assert (report.triangles, report.vertices, report.closed, report.outward) == (12, 8, True, True)
    assert report.bounds == ((-0.5, -1.0, -1.5), (0.5, 1.0, 1.5))
    assert report.volume == pytest.approx(6)


def test_the_order_of_vertices_and_faces_stays(tmp_path):
    rng = np.random.default_rng(0)
    vertices, faces = rng.normal(size=(50, 3)), rng.integers(0, 50, (80, 3))
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in vertices.tolist())
    text += "".join(f"f {a} {b} {c}\n" for a, b, c in (faces + 1).tolist())
    (tmp_path / "soup.obj").write_text(text)
    mesh = load_mesh(tmp_path / "soup.obj")
    np.testing.assert_array_equal(mesh.numpy()[0][mesh.numpy()[1]], vertices.astype(np.float32)[faces])


def test_zero_area_and_repeated_faces_are_kept(tmp_path):
    lines = ["OFF", "4 5 0", "0 0 0", "1 0 0", "0 1 0", "2 0 0"]
    lines += ["3 0 1 2", "3 0 1 2", "3 2 1 0", "3 0 1 1", "3 0 1 3"]
    (tmp_path / "a.off").write_text("\n".join(lines))
    report = inspect_mesh(load_mesh(tmp_path / "a.off"))
    assert (report.triangles, report.duplicate_faces, report.degenerate_faces) == (5, 2, 2)


def test_polygons_become_triangles(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv -1 0.5 0\nf 1 2 3 4\nf 1 2 3 4 5\n")
    report = inspect_mesh(load_mesh(tmp_path / "a.obj"))
    assert report.triangles == 5
    assert report.area == pytest.approx(1 + 1.5)


def test_texture_seams_do_not_open_a_mesh(tmp_path):
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in BOX.vertices.tolist())
    seams = "".join(f"vt {i / 40} {i / 50}\nvn {i} 0 1\n" for i in range(36))
    faces = "".join(
        "f " + " ".join(f"{v + 1}/{3 * i + c + 1}/{3 * i + c + 1}" for c, v in enumerate(face)) + "\n"
        for i, face in enumerate(BOX.faces.tolist())
    )
    (tmp_path / "a.obj").write_text("mtllib missing.mtl\nusemtl skin\n" + corners + seams + faces)
    assert inspect_mesh(load_mesh(tmp_path / "a.obj")).closed


def test_scenes_are_one_mesh_with_each_part_in_its_place(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(BOX, transform=np.diag([-2.0, 1, 1, 1]))
    away = np.eye(4)
    away[:3, 3] = (10, 20, 30)
    scene.add_geometry(BOX, transform=away)
    scene.add_geometry(trimesh.PointCloud(np.full((4, 3), 99.0)))
    scene.export(tmp_path / "scene.glb")
    report = inspect_mesh(load_mesh(tmp_path / "scene.glb"))
    assert (report.triangles, report.components, report.closed, report.outward) == (24, 2, True, True)
    assert report.volume == pytest.approx(6 * 2 + 6)
    assert report.bounds == ((-1.0, -1.0, -1.5), (10.5, 21.0, 31.5))


def test_the_same_part_twice(tmp_path):
    scene: Any = trimesh.Scene()
    name = scene.add_geometry(BOX)
    moved = np.eye(4)
    moved[0, 3] = 5
    scene.graph.update(frame_to="again", geometry=scene.graph[name][1], matrix=moved)
    scene.export(tmp_path / "scene.glb")
    assert inspect_mesh(load_mesh(tmp_path / "scene.glb")).components == 2


def test_positions_are_merged_only_where_they_are_equal(tmp_path):
    near = float(np.nextafter(np.float32(1), np.float32(2)))
    (tmp_path / "a.off").write_text(
        f"OFF\n6 2 0\n0 0 0\n1 0 0\n0 1 0\n-0 0 0\n{near!r} 0 0\n0 -1 0\n3 0 1 2\n3 3 4 5\n"
    )
    mesh = load_mesh(tmp_path / "a.off")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 3, 4]]


def test_the_mesh_files_of_a_folder(tmp_path):
    for name in ("b.stl", "a.PLY", "c.obj", "notes.txt", "c.mtl", ".hidden.stl", "map.nii.gz", "x.zip"):
        (tmp_path / name).write_text("")
    (tmp_path / "folder.stl").mkdir()
    assert [path.name for path in mesh_files(tmp_path)] == ["a.PLY", "b.stl", "c.obj"]


def test_real_meshes(data_dir):
    files = mesh_files(data_dir / "meshes")
    assert files
    for path in files:
        mesh = load_mesh(path)
        assert len(mesh) > 0
        assert inspect_mesh(mesh).name == path.name


def test_a_mesh_that_was_written_is_read(tmp_path):
    mesh = demo_mesh()
    write_ply(mesh, tmp_path / "a.ply")
    again = load_mesh(tmp_path / "a.ply")
    for found, expected in zip(again.numpy(), mesh.numpy(), strict=True):
        np.testing.assert_array_equal(found, expected)
    with pytest.raises(FormatError, match="make it first"):
        write_ply(mesh, tmp_path / "none" / "a.ply")


CUBE = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
SQUARES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = [corners for a, b, c, d in SQUARES for corners in ((a, b, c), (a, c, d))]


def _obj(faces, shift: int = 0, first: int = 1) -> str:
    """A cube's part of an OBJ file, whose faces count from `first`."""
    text = "".join(f"v {x + shift} {y} {z}\n" for x, y, z in CUBE)
    return text + "".join(f"f {' '.join(str(corner + first) for corner in face)}\n" for face in faces)


@pytest.mark.parametrize("faces", [TRIANGLES, SQUARES], ids=["triangles", "squares"])
def test_negative_numbers_of_an_obj_count_back_from_their_face(faces, tmp_path):
    (tmp_path / "a.obj").write_text(_obj(faces, first=-8) + _obj(faces, shift=3, first=-8))
    report = inspect_mesh(load_mesh(tmp_path / "a.obj"))
    assert (report.triangles, report.vertices, report.closed) == (24, 16, True)
    assert report.bounds == ((0, 0, 0), (4, 1, 1))
    # A number from before the first vertex is none of a later one's.
    (tmp_path / "b.obj").write_text(_obj(faces, first=-9) + _obj(faces, shift=3, first=-8))
    with pytest.raises(MeshError, match="not there"):
        load_mesh(tmp_path / "b.obj")


def test_concave_polygons_with_negative_numbers(tmp_path):
    part = "v {0} 0 0\nv {1} 2 0\nv {0} 1 0\nv {2} 2 0\nf -4 -3 -2 -1\n"
    (tmp_path / "a.obj").write_text(part.format(0, 1, -1) + part.format(10, 12, 8))
    report = inspect_mesh(load_mesh(tmp_path / "a.obj"))
    assert (report.triangles, report.bounds) == (4, ((-1, 0, 0), (12, 2, 0)))
    assert report.area == pytest.approx(1 + 2)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("v ", "v\t").replace("f ", "f\t"),
        lambda text: text.replace("f 2", "  f 2"),
        lambda text: "  \t" + text.replace("\n", "\n  \t"),
        lambda text: text.replace("v 1", "v\t1"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n ").replace("f ", "f\t"),
        lambda text: text.replace("f 1 2", "f 1 \\\n 2"),
    ],
    ids=["tabs", "some indented", "all indented", "some tabs", "byte order mark", "CRLF", "continued"],
)
@pytest.mark.parametrize("faces", [TRIANGLES, SQUARES], ids=["triangles", "squares"])
def test_obj_lines_with_other_white_space(faces, change, tmp_path):
    (tmp_path / "a.obj").write_bytes(change(_obj(faces)).encode())
    report = inspect_mesh(load_mesh(tmp_path / "a.obj"))
    assert (report.triangles, report.vertices, report.closed, report.outward) == (12, 8, True, True)
