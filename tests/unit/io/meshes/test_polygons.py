"""Concave polygons of files, cut into triangles that fill them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import sdm
from sdm.errors import MeshError
from sdm.inspect import inspect_mesh
from sdm.io import load_mesh
from sdm.io.meshes.polygons import clip_ears

U = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]


def prism(outline: list) -> tuple[list, list]:
    """A prism of height 1: vertices, and faces with any number of corners."""
    n = len(outline)
    sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    return [(*p, z) for z in (0, 1) for p in outline], [[*range(n)][::-1], [*range(n, 2 * n)], *sides]


def write(path: Path, vertices: list, faces: list) -> Path:
    points = "".join("{:g} {:g} {:g}\n".format(*v) for v in vertices)
    rows = "".join(f"{len(f)} {' '.join(map(str, f))}\n" for f in faces)
    if path.suffix == ".obj":
        # With normals and continued lines, as some programs write them.
        lines = [f"v {line}\n" for line in points.splitlines()] + ["vn 0 0 1\n"]
        lines += ["f \\\r\n" + " ".join(f"{v + 1}//1" for v in f) + "\r\n" for f in faces]
        path.write_text("".join(lines), newline="")
    elif path.suffix == ".off":
        path.write_text(f"OFF # of a test\n{len(vertices)} {len(faces)} 0\n{points}{rows}")
    else:
        path.write_text(ply_header("ascii", vertices, faces) + points + rows)
    return path


def ply_header(encoding: str, vertices: list, faces: list) -> str:
    xyz = "".join(f"property float {axis}\n" for axis in "xyz")
    lists = "property list uchar int vertex_indices\n"
    parts = f"element vertex {len(vertices)}\n{xyz}element face {len(faces)}\n{lists}"
    return f"ply\nformat {encoding} 1.0\n{parts}end_header\n"


@pytest.mark.parametrize("first", [0, 3, 5])
@pytest.mark.parametrize("ending", ["obj", "ply", "off"])
def test_a_bracket_with_concave_caps_is_filled_rightly(ending, first, tmp_path):
    mesh = load_mesh(write(tmp_path / f"u.{ending}", *prism(U[first:] + U[:first])))
    report = inspect_mesh(mesh)
    assert (report.closed, report.outward, report.triangles, report.vertices) == (True, True, 28, 16)
    assert (report.area, report.volume) == (pytest.approx(30), pytest.approx(7))
    # In the mouth of the U, one half from each arm.
    assert float(sdm.signed_distance(mesh, [1.5, 2.0, 1.0])) == pytest.approx(0.5)


@pytest.mark.parametrize("ending", ["obj", "ply", "off"])
def test_a_concave_quad_is_cut_along_the_diagonal_within_it(ending, tmp_path):
    quad = [(0, 0, 0), (2, 1, 0), (0, 2, 0), (1, 1, 0)]
    assert inspect_mesh(load_mesh(write(tmp_path / f"q.{ending}", quad, [[0, 1, 2, 3]]))).area == pytest.approx(1)


def test_a_concave_polygon_of_a_binary_ply_file(tmp_path):
    vertices, faces = [(*p, 0.0) for p in U[3:] + U[:3]], [[*range(8)]]
    data = np.asarray(vertices, "<f4").tobytes() + struct.pack("<B8i", 8, *faces[0])
    (tmp_path / "u.ply").write_bytes(ply_header("binary_little_endian", vertices, faces).encode() + data)
    assert inspect_mesh(load_mesh(tmp_path / "u.ply")).area == pytest.approx(7)


@pytest.mark.parametrize("encoding", ["binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("more", [False, True])
def test_a_binary_ply_file_with_faces_of_several_kinds(more, encoding, tmp_path):
    """As the same file in text, also with what else such files hold."""
    vertices, faces = prism(U)
    # Octagons and quads, triangles, and a line, which is no face.
    faces = [*faces, [8, 9, 10], [10, 9, 8], [0, 1]]
    header, order = ply_header(encoding, vertices, faces), "<" if "little" in encoding else ">"
    if more:
        header = header.replace("property float z\n", "property float z\nproperty uchar red\n")
        header = header.replace(
            "element face", "comment of \u00e9 face\nelement other 2\nproperty double w\nelement face"
        )
        lists = "property list uchar int vertex_indices\n"
        header = header.replace(
            lists, "property short kind\nproperty list uint16 int32 vertex_index\nproperty int8 flag\n"
        )
        header = header.replace("end_header", "element last 1\nproperty list uchar int vertex_indices\nend_header")
    data = header.encode() + b"".join(struct.pack(f"{order}3f{more:d}x", *vertex) for vertex in vertices)
    if more:
        data += bytes(16)
    for face in faces:
        row = f"{order}hH{len(face)}ib" if more else f"{order}B{len(face)}i"
        data += struct.pack(row, *((7, len(face), *face, 5) if more else (len(face), *face)))
    (tmp_path / "u.ply").write_bytes(data + (b"\1\0\0\0\0" if more else b""))
    found, same = load_mesh(tmp_path / "u.ply"), load_mesh(write(tmp_path / "text.ply", vertices, faces))
    assert found.vertices.tolist() == same.vertices.tolist()
    assert found.faces.tolist() == same.faces.tolist()
    assert len(found) == 30


def test_a_binary_ply_file_that_is_as_long_as_if_all_faces_were_quads(tmp_path):
    vertices, faces = prism(U)
    faces = [[0, 1, 9, 8], [1, 2, 10], [8, 9, 10, 11, 12]]
    data = np.asarray(vertices, "<f4").tobytes()
    data += b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    (tmp_path / "u.ply").write_bytes(ply_header("binary_little_endian", vertices, faces).encode() + data)
    assert len(load_mesh(tmp_path / "u.ply")) == 6


def test_damaged_binary_ply_files_with_faces_of_several_kinds(tmp_path):
    vertices, faces = prism(U)
    header = ply_header("binary_little_endian", vertices, faces).encode()
    data = header + np.asarray(vertices, "<f4").tobytes()
    rows = b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    count = f"element face {len(faces)}".encode()
    for number, content in enumerate(
        [
            data + rows[:-1],
            data,
            data + rows[:-4] + struct.pack("<i", 99),
            data + rows[:-4] + struct.pack("<i", -1),
            data + b"\xff" + rows[1:],
            data.replace(count, b"element face 999999999999999999999999") + rows,
            data.replace(count, b"element face 99999999999999") + rows,
            data.replace(count, b"element face -3") + rows,
            data.replace(b"uchar int", b"uchar object") + rows,
            data.replace(b"uchar int", b"uchar nothing") + rows,
            data.replace(b"list uchar", b"list float") + rows,
        ]
    ):
        path = tmp_path / f"{number}.ply"
        path.write_bytes(content)
        with pytest.raises(MeshError, match=rf"{number}\.ply"):
            load_mesh(path)


@pytest.mark.parametrize("ending", ["obj", "ply", "off"])
def test_convex_polygons_stay_fans(ending, tmp_path):
    angle = np.arange(6) * np.pi / 3
    mesh = load_mesh(
        write(tmp_path / f"hexagon.{ending}", [(*p, 0.0) for p in np.c_[np.cos(angle), np.sin(angle)]], [[*range(6)]])
    )
    assert mesh.faces.tolist() == [[0, n, n + 1] for n in range(1, 5)]


def area(corners: np.ndarray, triangles: np.ndarray) -> tuple[float, float]:
    """The sum of the triangles' areas, and the size of the sum of their area vectors."""
    a, b, c = np.moveaxis(corners[triangles], 1, 0)
    vectors = np.cross(b - a, c - a) / 2
    return float(np.linalg.norm(vectors, axis=1).sum()), float(np.linalg.norm(vectors.sum(0)))


@pytest.mark.parametrize("seed", range(20))
def test_random_stars_in_any_plane(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 60))
    angle = np.sort(rng.uniform(0, 2 * np.pi, count))
    flat = rng.uniform(0.2, 1, (count, 1)) * np.c_[np.cos(angle), np.sin(angle)]
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    corners = (flat @ frame[:2] + rng.normal(size=3)).astype(np.float32).astype(np.float64)
    # A gap of half a turn or more between two corners can make a star cut itself.
    if np.diff([*angle, angle[0] + 2 * np.pi]).max() > 3:
        return
    triangles = clip_ears(corners)
    assert sorted({corner for t in triangles for corner in t}) == list(range(count))
    total, net = area(corners, triangles)
    assert len(triangles) == count - 2
    assert total == pytest.approx(net, rel=1e-5)


def test_corners_on_a_line_and_a_hole_with_a_bridge():
    ring = [(0, 0), (2, 0), (4, 0), (4, 4), (3, 4), (0, 4), (0, 0), (1, 1), (1, 3), (2, 3), (3, 3), (3, 1), (1, 1)]
    for first in range(len(ring)):
        corners = np.array([(*p, 0.0) for p in ring[first:] + ring[:first]])
        total, net = area(corners, clip_ears(corners))
        assert (total, net) == (pytest.approx(12), pytest.approx(12))


def test_a_polygon_that_cuts_itself_is_a_fan():
    corners = np.array([(0, 0, 0), (2, 2, 0), (2, 0, 0), (0, 3, 0), (-1, 1, 0.5)], float)
    assert clip_ears(corners).tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]


@pytest.mark.parametrize(
    ("style", "corners", "hexagon"),
    [("{}/1/1", (1, 2, 3, 4), "{}//1"), ("{}/1/1", (1, 2, 3, 4), "{}/1"), ("{}//1", (1, 2, 3), "{}")],
)
def test_faces_of_an_obj_with_as_many_numbers_but_other_corners(style, corners, hexagon, tmp_path):
    text = (
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 5 0 0\nv 6 0 0\nv 7 1 0\nv 6 2 0\nv 5 2 0\nv 4 1 0\nvt 0 0\nvn 0 0 1\n"
    )
    faces = [[style.format(number) for number in corners], [hexagon.format(number) for number in range(5, 11)]]
    (tmp_path / "a.obj").write_text(text + "".join(f"f {' '.join(face)}\n" for face in faces))
    report = inspect_mesh(load_mesh(tmp_path / "a.obj"))
    assert (report.triangles, report.bounds) == (len(corners) - 2 + 4, ((0, 0, 0), (7, 2, 0)))
    assert report.area == pytest.approx((len(corners) - 2) / 2 + 4)
