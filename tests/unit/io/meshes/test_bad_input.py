from __future__ import annotations

import json
import logging
import os
from typing import Any

import numpy as np
import pytest
import trimesh

from sdm.errors import MeshError
from sdm.io import load_mesh

PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""
OFF = "OFF\n3 1 0\n"
CORNERS = "0 0 0\n1 0 0\n0 1 0\n"
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
STL: Any = trimesh.creation.box().export(file_type="stl")


def refused(path, *words: str) -> None:
    with pytest.raises(MeshError) as error:
        load_mesh(path)
    text = str(error.value)
    assert "\n" not in text
    assert path.name in text
    for word in words:
        assert word in text, text


def test_no_file(tmp_path):
    refused(tmp_path / "missing.stl", "there is no mesh file")
    refused(tmp_path / "missing", "there is no mesh file")
    refused(tmp_path / ("x" * 300 + ".stl"), "cannot be read")


def test_a_folder(tmp_path):
    (tmp_path / "folder.stl").mkdir()
    refused(tmp_path / "folder.stl", "is a folder")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission(tmp_path):
    (tmp_path / "a.off").write_text(OFF + CORNERS + "3 0 1 2\n")
    (tmp_path / "a.off").chmod(0)
    refused(tmp_path / "a.off", "Permission denied")


@pytest.mark.parametrize("name", ["a.foo", "a", "a.txt", "stl"])
def test_an_ending_that_is_not_known(name, tmp_path):
    (tmp_path / name).write_text("x")
    refused(tmp_path / name, ".stl, .ply, .obj")


def test_the_ending_of_an_image(tmp_path):
    (tmp_path / "a.nii.gz").write_text("x")
    refused(tmp_path / "a.nii.gz", "ends like an image or a map")


@pytest.mark.parametrize("ending", ["stl", "ply", "obj", "off", "glb", "gltf", "zip", "dxf", "xyz"])
@pytest.mark.parametrize("content", [b"", b"hello world\n", bytes(range(256)) * 8], ids=["empty", "words", "bytes"])
def test_files_that_are_something_else(content, ending, tmp_path):
    path = tmp_path / f"a.{ending}"
    path.write_bytes(content)
    refused(path)


@pytest.mark.parametrize("ending", ["stl", "ply", "off", "glb"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_files_that_are_cut_off(ending, share, tmp_path):
    path = tmp_path / f"a.{ending}"
    trimesh.creation.icosphere(2).export(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    refused(path)


def test_vertices_of_two_coordinates(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    refused(tmp_path / "a.obj", "fewer than 3 coordinates")
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n")
    refused(tmp_path / "b.obj", "fewer than 3 coordinates")
    (tmp_path / "c.obj").write_text("v 0 0 0\nv 2 1\nv 0 2 0\nv 1 1 0\nf 1 2 3 4\n")
    refused(tmp_path / "c.obj", "fewer than 3 coordinates")


def test_a_name_that_is_not_utf_8(tmp_path):
    path = tmp_path / os.fsdecode(b"b\xff.stl")
    path.write_bytes(STL)
    refused(path, "its name, or one in it, is not UTF-8")


def test_a_cut_off_stl_says_how_much_is_there(tmp_path):
    (tmp_path / "a.stl").write_bytes(STL[:-30])
    refused(tmp_path / "a.stl", "its header promises 12 triangles, and 11 are there")


def test_a_cut_off_ascii_stl(tmp_path):
    text: Any = trimesh.creation.box().export(file_type="stl_ascii")
    (tmp_path / "a.stl").write_text(text[: text.index("facet", len(text) // 2)])
    refused(tmp_path / "a.stl", "endsolid")


def test_a_cut_off_off_of_quads(tmp_path):
    text = "OFF  # a comment\n\n8 4 0\n" + "".join(f"{i % 2} {i // 2 % 2} {i // 4}\n" for i in range(8))
    (tmp_path / "a.off").write_text(text + "4 0 1 3 2\n# 4 4 5 7 6\n4 0 1 5 4\n4 2 3 7 6\n")
    refused(tmp_path / "a.off", "promises 12 lines, and 11 are there")


def test_a_cut_off_ascii_ply(tmp_path):
    (tmp_path / "a.ply").write_text(PLY.replace("face 1", "face 4") + CORNERS + "3 0 1 2\n")
    refused(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("points.ply", PLY.replace("element face 1\nproperty list uchar int vertex_indices\n", "") + CORNERS),
        ("points.obj", OBJ),
        ("lines.obj", OBJ + "l 1 2 3\n"),
        ("points.xyz", CORNERS),
        ("none.off", "OFF\n3 0 0\n" + CORNERS),
        ("none.stl", "solid x\nendsolid x\n"),
    ],
)
def test_no_triangles(name, content, tmp_path):
    (tmp_path / name).write_text(content)
    refused(tmp_path / name)


@pytest.mark.parametrize("bad", ["nan", "inf", "-inf", "1e39"])
@pytest.mark.parametrize("ending", ["ply", "obj", "off", "stl"])
def test_coordinates_that_are_not_finite(ending, bad, tmp_path):
    corners = CORNERS.replace("1 0 0", f"{bad} 0 0")
    content = {
        "ply": PLY.replace("float", "double") + corners + "3 0 1 2\n",
        "obj": "".join(f"v {line}\n" for line in corners.splitlines()) + "f 1 2 3\n",
        "off": OFF + corners + "3 0 1 2\n",
        "stl": "solid x\nfacet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {line}\n" for line in corners.splitlines())
        + "endloop\nendfacet\nendsolid x\n",
    }
    (tmp_path / f"a.{ending}").write_text(content[ending])
    refused(tmp_path / f"a.{ending}", "must be finite" if bad != "1e39" else "1e+39")


def test_a_nan_in_a_binary_file(tmp_path):
    data = bytearray(STL)
    data[84 + 12 : 84 + 16] = np.float32(np.nan).tobytes()
    (tmp_path / "a.stl").write_bytes(data)
    refused(tmp_path / "a.stl", "must be finite")


@pytest.mark.parametrize("said", [0, 5, 12])
def test_a_binary_stl_with_more_than_it_says(said, tmp_path):
    (tmp_path / "a.stl").write_bytes(STL[:80] + said.to_bytes(4, "little") + STL[84:] + b"more")
    refused(tmp_path / "a.stl", f"promises {said} triangles")


@pytest.mark.parametrize("face", ["1 2 9", "1 2 -9", "0 1 2", "1/1 0/1 2/1", "1//1 2//1 0//1", "1 2 00"])
def test_obj_faces_out_of_range(face, tmp_path):
    (tmp_path / "a.obj").write_text(f"{OBJ}vt 0 0\nvn 0 0 1\nf 1 2 3\nf {face}\n")
    refused(tmp_path / "a.obj", "uses")


@pytest.mark.parametrize("face", ["-1 -2 -3", "1/1 2/1 3/1", "10 1 2"])
def test_obj_faces_in_range(face, tmp_path):
    more = "v 5 5 5\n" * 7
    (tmp_path / "a.obj").write_text(f"{OBJ}{more}vt 0 0\nf {face}\n")
    assert len(load_mesh(tmp_path / "a.obj")) == 1


@pytest.mark.parametrize("face", ["0 1 7", "0 1 -1"])
@pytest.mark.parametrize(("ending", "head"), [("ply", PLY), ("off", OFF)])
def test_faces_out_of_range(ending, head, face, tmp_path):
    (tmp_path / f"a.{ending}").write_text(f"{head}{CORNERS}3 {face}\n")
    refused(tmp_path / f"a.{ending}")


def test_a_bad_part_is_not_hidden_by_the_next_one(tmp_path, monkeypatch):
    good = trimesh.creation.box()
    bad = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    scene = trimesh.Scene([bad, good])
    bad.faces = [[0, 1, 5]]
    monkeypatch.setattr(trimesh, "load_scene", lambda *args, **kwargs: scene)
    (tmp_path / "a.glb").write_bytes(b"x")
    refused(tmp_path / "a.glb", "uses vertex 5")


def test_whatever_a_parser_raises_is_one_sentence(tmp_path, monkeypatch):
    (tmp_path / "a.glb").write_bytes(b"x")
    for error in (
        KeyError("x"),
        RecursionError(),
        ZeroDivisionError("two\nlines"),
        AssertionError(),
        OSError(5, "disk"),
    ):

        def broken(*args, error=error, **kwargs):
            raise error

        monkeypatch.setattr(trimesh, "load_scene", broken)
        refused(tmp_path / "a.glb")


def test_a_bad_file_prints_nothing(tmp_path, capfd):
    logging.getLogger("trimesh").setLevel(logging.WARNING)
    (tmp_path / "a.ply").write_text("hello")
    refused(tmp_path / "a.ply")
    assert capfd.readouterr() == ("", "")


def _gltf(path, change) -> None:
    scene: Any = trimesh.Scene(trimesh.creation.box()).export(file_type="glb")
    begin, size = 20, int.from_bytes(scene[12:16], "little")
    document = json.loads(scene[begin : begin + size])
    primitive = document["meshes"][0]["primitives"][0]
    change(document, primitive, document["accessors"][primitive["attributes"]["POSITION"]])
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = scene[begin + size :]
    head = scene[:8] + (begin + len(text) + len(rest)).to_bytes(4, "little") + len(text).to_bytes(4, "little")
    path.write_bytes(head + scene[16:20] + text + rest)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda document, *_: document.update(accessors=["x"]), "its accessors are no list of objects"),
        (lambda document, *_: document.update(nodes={"mesh": 0}), "names in place of numbers, as in glTF 1"),
        (lambda document, *_: document["meshes"][0].pop("primitives"), "mesh 0 has no list of primitives"),
        (lambda _, primitive, vertices: primitive["attributes"].update(POSITION=70), "mesh 0 has 70 as POSITION, and"),
        (lambda _, primitive, vertices: primitive.update(indices="a"), "mesh 0 has 'a' as indices, and there are"),
        (lambda _, primitive, vertices: vertices.update(bufferView=-1), "has -1 as bufferView, and there are"),
        (lambda document, *_: document["bufferViews"][0].update(buffer=3), "bufferView 0 has 3 as buffer, and"),
        (lambda document, *_: document["nodes"][-1].update(mesh=1), "has 1 as mesh, and there are 1 meshes"),
    ],
)
def test_gltf_of_parts_that_are_not_there(change, words, tmp_path):
    _gltf(tmp_path / "a.glb", change)
    refused(tmp_path / "a.glb", "cannot be read: it", words)


def test_a_gltf_file_whose_buffer_names_no_file(tmp_path):
    trimesh.Scene(trimesh.creation.box()).export(tmp_path / "a.gltf")
    document = json.loads((tmp_path / "a.gltf").read_text())
    for buffer in document["buffers"]:
        buffer.pop("uri", None)
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    refused(tmp_path / "a.gltf", "a buffer names no file")


def _draco(document, primitive, vertices) -> None:
    primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    vertices.pop("bufferView")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_draco, "Draco"),
        (lambda _, primitive, vertices: vertices.update(sparse={"count": 1}), "sparse"),
        (lambda _, primitive, vertices: vertices.update(normalized=True, componentType=5123), "normalized"),
        (lambda _, primitive, vertices: primitive.update(mode=6), "fans"),
        (lambda document, *_: document["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {}}), "instances"),
    ],
    ids=["Draco", "sparse", "normalized", "fan", "instances"],
)
def test_gltf_that_would_be_read_wrongly(change, words, tmp_path, monkeypatch):
    # With DracoPy, trimesh reads what Draco compressed.
    monkeypatch.setattr("sdm.io.meshes.gltf.check.find_spec", lambda name: None)
    _gltf(tmp_path / "a.glb", lambda *_: None)
    assert len(load_mesh(tmp_path / "a.glb")) == 12
    _gltf(tmp_path / "b.glb", change)
    refused(tmp_path / "b.glb", words, "are not read")
