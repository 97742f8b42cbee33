"""Files that worker processes read: the same mesh as `load_mesh` gives, or none."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sdm.io import load_mesh
from sdm.io.maps.record import digest_of
from sdm.io.meshes.arrays import binary_files
from sdm.io.meshes.arrays.binary_files import read_binary


def written(path: Path, mesh: trimesh.Trimesh, **options) -> Path:
    mesh.export(path, **options)
    return path


def open_ball() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(2)
    return trimesh.Trimesh(ball.vertices, ball.faces[:-3], process=False)


@pytest.mark.parametrize("name", ["ball.ply", "ball.PLY", "ball.stl"])
@pytest.mark.parametrize("closed", [True, False], ids=["closed", "open"])
def test_the_same_mesh(tmp_path, name, closed):
    path = tmp_path / name
    ball = trimesh.creation.icosphere(2) if closed else open_ball()
    path.write_bytes(ball.export(file_type=path.suffix[1:].lower()))
    found, mesh = read_binary(path, " float16"), load_mesh(path)
    assert found is not None
    vertices, faces = mesh.numpy()
    for one, other in ((found.vertices, vertices), (found.faces, faces)):
        assert one.dtype == other.dtype
        assert one.flags.c_contiguous
        np.testing.assert_array_equal(one, other)
    assert found.digest == digest_of(mesh, " float16") != digest_of(mesh)
    assert found.paired == closed
    np.testing.assert_array_equal(found.box, mesh.bounds)
    assert found.largest == float(np.abs(vertices).max())


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.ply", b"ply\n"),
        ("a.ply", b""),
        ("a.stl", b"x" * 90),
        ("a.stl", b"solid of text\nendsolid\n"),
        ("a.stl", bytes(84)),
        ("a.obj", b"v 0 0 0\n"),
        ("a", b""),
    ],
    ids=["damaged", "empty", "no stl", "text", "no triangles", "another format", "no ending"],
)
def test_what_load_mesh_is_to_say(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    assert read_binary(tmp_path / name, "") is None
    assert read_binary(tmp_path / "none.ply", "") is None
    assert read_binary(tmp_path, "") is None


def test_the_box_is_that_of_vertices_that_faces_use(tmp_path):
    ball = trimesh.creation.icosphere(2)
    some = trimesh.Trimesh(ball.vertices, ball.faces[:7], process=False)
    path = written(tmp_path / "some.ply", some)
    found = read_binary(path, "")
    assert found is not None
    np.testing.assert_array_equal(found.box, load_mesh(path).bounds)
    assert found.largest > float(np.abs(found.box).max())


def test_text_and_large_files_are_not_for_them(tmp_path, monkeypatch):
    assert read_binary(written(tmp_path / "text.ply", open_ball(), encoding="ascii"), "") is None
    path = written(tmp_path / "ball.ply", open_ball())
    assert read_binary(path, "") is not None
    monkeypatch.setattr(binary_files, "LARGEST", path.stat().st_size - 1)
    assert read_binary(path, "") is None


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e39])
def test_coordinates_that_are_not_finite(tmp_path, wrong):
    mesh = open_ball()
    head = b"".join(b"property double %c\n" % axis for axis in b"xyz")
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex %d\n%selement face 1\n" % (len(mesh.vertices), head)
    vertices = mesh.vertices.copy()
    vertices[3, 1] = wrong
    path = tmp_path / "a.ply"
    path.write_bytes(
        head + b"property list uchar int vertex_indices\nend_header\n" + vertices.tobytes() + bytes([3]) + bytes(12)
    )
    assert read_binary(path, "") is None


def test_processes_import_neither_torch_nor_warp():
    script = "import json, sys, sdm.io.meshes.arrays.binary_files, sdm.runtime.worker_processes.serve\n"
    script += "print(json.dumps([*sys.modules]))"
    names = json.loads(subprocess.run([sys.executable, "-c", script], check=True, capture_output=True).stdout)
    assert not {"torch", "warp", "trimesh", "nibabel", "scipy"} & set(names)
