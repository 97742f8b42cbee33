"""Formats that trimesh reads, with and without the packages that it needs for them."""

from __future__ import annotations

import json
import sys

import pytest
import trimesh

from sdm.errors import MeshError
from sdm.inspect import inspect_mesh
from sdm.io import load_mesh, mesh_files
from sdm.io.meshes import formats


@pytest.fixture
def nothing_installed(monkeypatch):
    monkeypatch.setattr(formats, "find_spec", lambda name: None)


@pytest.mark.parametrize(("ending", "module"), [("dae", "collada"), ("3mf", "lxml")])
def test_formats_of_the_extra(ending, module, tmp_path):
    pytest.importorskip(module)
    trimesh.creation.box((1, 2, 3)).export(tmp_path / f"a.{ending}")
    report = inspect_mesh(load_mesh(tmp_path / f"a.{ending}"))
    assert (report.triangles, report.closed, report.volume) == (12, True, pytest.approx(6))
    assert [path.name for path in mesh_files(tmp_path)] == [f"a.{ending}"]


@pytest.mark.parametrize(
    ("ending", "needs"),
    [("dae", "collada"), ("zae", "collada"), ("3mf", "lxml"), ("3dxml", "lxml"), ("xaml", "lxml")],
)
@pytest.mark.usefixtures("nothing_installed")
def test_a_format_whose_reader_is_not_installed(ending, needs, tmp_path):
    (tmp_path / f"a.{ending}").write_text("x")
    with pytest.raises(MeshError, match=rf"a\.{ending} needs {needs} to be read: pip install '\.\[formats\]'"):
        load_mesh(tmp_path / f"a.{ending}")
    assert mesh_files(tmp_path) == []


@pytest.mark.parametrize("ending", ["ctm", "msh", "step"])
def test_formats_that_are_not_read(ending, tmp_path):
    if ending in trimesh.available_formats():
        pytest.skip("a package that reads it is installed")
    (tmp_path / f"a.{ending}").write_text("x")
    with pytest.raises(MeshError, match=rf"is no mesh by the ending \.{ending}; known are .*\.3mf.*\.dae"):
        load_mesh(tmp_path / f"a.{ending}")


def test_a_missing_package_is_not_called_damage(tmp_path, monkeypatch):
    (tmp_path / "a.glb").write_bytes(b"x")

    def load_scene(*args, **kwargs):
        raise ModuleNotFoundError("No module named 'charset_normalizer'", name="charset_normalizer")

    monkeypatch.setattr(trimesh, "load_scene", load_scene)
    with pytest.raises(MeshError, match=r"cannot be read without charset_normalizer: pip install"):
        load_mesh(tmp_path / "a.glb")


def test_a_usual_file_is_read_without_trimesh(tmp_path, monkeypatch):
    trimesh.creation.box().export(tmp_path / "a.stl")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    assert len(load_mesh(tmp_path / "a.stl")) == 12


@pytest.mark.parametrize("content", [b"hello", b"\xff\xfe\x00", b"{", b'{"asset":'])
def test_a_gltf_that_is_no_json(content, tmp_path):
    (tmp_path / "scene.gltf").write_bytes(content)
    with pytest.raises(MeshError, match=r"scene\.gltf cannot be read; it is damaged.*holds no JSON"):
        load_mesh(tmp_path / "scene.gltf")


def hollow_glb(count: int, used: bool) -> bytes:
    """A GLB file of one triangle in base64, with `count` vertices that no buffer holds."""
    accessors = [
        {"componentType": 5126, "count": count, "type": "VEC3"},
        {"bufferView": 0, "componentType": 5125, "count": 3, "type": "SCALAR"},
        {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC3"},
    ]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0 if used else 2}, "indices": 1}]}],
        "accessors": accessors,
        "bufferViews": [{"buffer": 0, "byteLength": 12}, {"buffer": 0, "byteOffset": 12, "byteLength": 36}],
        "buffers": [{"byteLength": 48}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    data = b"".join(number.to_bytes(4, "little") for number in (0, 1, 2)) + bytes(36)
    chunks = len(text).to_bytes(4, "little") + b"JSON" + text + len(data).to_bytes(4, "little") + b"BIN\0" + data
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks


@pytest.mark.parametrize("used", [True, False])
def test_a_glb_with_more_vertices_than_it_has_bytes(used, tmp_path):
    (tmp_path / "a.glb").write_bytes(hollow_glb(60_000_000, used))
    with pytest.raises(MeshError, match="more vertices than its buffers hold"):
        load_mesh(tmp_path / "a.glb")


def test_a_glb_with_a_few_vertices_in_no_buffer(tmp_path):
    (tmp_path / "a.glb").write_bytes(hollow_glb(3, True))
    with pytest.raises(MeshError, match="vertices that are in no buffer"):
        load_mesh(tmp_path / "a.glb")


def test_a_drawing_with_faces(tmp_path):
    (tmp_path / "a.dxf").write_text("0\nSECTION\n2\nENTITIES\n0\n3DFACE\n8\n0\n0\nENDSEC\n0\nEOF\n")
    with pytest.raises(MeshError, match=r"a\.dxf"):
        load_mesh(tmp_path / "a.dxf")


@pytest.mark.parametrize(
    "broken",
    [
        '<library_lights><light id="lamp"><technique_common/></light></library_lights>',
        '<library_cameras><camera id="eye"/></library_cameras>',
        (
            '<library_effects><effect id="red"><profile_COMMON><technique sid="t"><phong><diffuse>'
            "<color>a b c d</color></diffuse></phong></technique></profile_COMMON></effect></library_effects>"
        ),
    ],
    ids=["light", "camera", "effect"],
)
def test_a_broken_lamp_is_no_broken_mesh(broken, tmp_path):
    collada = pytest.importorskip("collada")
    path = tmp_path / "a.dae"
    trimesh.creation.box((1, 2, 3)).export(path)
    text = path.read_text()
    at = text.index("<library_geometries>")
    path.write_text(text[:at] + broken + text[at:])
    with pytest.raises(collada.common.DaeError):
        trimesh.load_scene(path, ignore_broken=False)
    report = inspect_mesh(load_mesh(path))
    assert (report.triangles, report.closed, report.volume) == (12, True, pytest.approx(6))
    # What is broken of the mesh itself is not passed over.
    path.write_text(path.read_text().replace("<float_array ", "<float_array>x</float_array><float_array ", 1))
    with pytest.raises(MeshError, match="cannot be read"):
        load_mesh(path)


def test_a_part_of_its_own_that_is_missing(tmp_path):
    trimesh.Scene(trimesh.creation.box()).export(tmp_path / "a.gltf")
    for part in tmp_path.glob("*.bin"):
        part.unlink()
    with pytest.raises(MeshError, match=r"a\.gltf cannot be read: it needs .*\.bin, and that file is not there"):
        load_mesh(tmp_path / "a.gltf")


def test_an_error_without_a_word_has_a_name(tmp_path, monkeypatch):
    (tmp_path / "a.dae").write_text("<x/>")
    monkeypatch.setattr(formats, "_is_installed", lambda ending: True)

    def load_scene(*args, **kwargs):
        raise RuntimeError

    monkeypatch.setattr(trimesh, "load_scene", load_scene)
    with pytest.raises(MeshError, match=r"not what its name says \(RuntimeError\)"):
        load_mesh(tmp_path / "a.dae")
