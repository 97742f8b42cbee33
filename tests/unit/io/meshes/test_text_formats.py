"""Text meshes: every face that a file declares, or a refusal."""

from __future__ import annotations

import sys
from typing import Any

import pytest
import trimesh

from sdm.errors import MeshError
from sdm.io import load_mesh

CORNERS = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
FACES = "3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
OFF = f"OFF\n4 4 0\n{CORNERS}{FACES}"
PLY = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
PLY += f"element face 4\nproperty list uchar int vertex_indices\nend_header\n{CORNERS}{FACES}"
OBJ = "".join(f"v {line}\n" for line in CORNERS.splitlines()) + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
TEXTS = {"off": OFF, "ply": PLY, "obj": OBJ}


def refused(path) -> str:
    with pytest.raises(MeshError) as error:
        load_mesh(path)
    assert "\n" not in str(error.value)
    assert path.name in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("ending", TEXTS)
def test_the_whole_files_are_read(ending, tmp_path):
    (tmp_path / f"a.{ending}").write_text(TEXTS[ending])
    assert len(load_mesh(tmp_path / f"a.{ending}")) == 4


@pytest.mark.parametrize("ending", ["off", "ply"])
@pytest.mark.parametrize("cut", range(2, 8))
def test_a_last_face_that_is_cut_is_no_face_less(ending, cut, tmp_path):
    (tmp_path / f"cut.{ending}").write_text(TEXTS[ending][:-cut])
    refused(tmp_path / f"cut.{ending}")


def test_a_cut_face_is_named(tmp_path):
    (tmp_path / "cut.off").write_text(OFF[: -len(" 3\n")])
    assert "holds less than it says" in refused(tmp_path / "cut.off")
    assert "face 3 of 4 declares 3 corners, and 2 are there" in refused(tmp_path / "cut.off")


@pytest.mark.parametrize("ending", TEXTS)
def test_a_short_line_in_the_middle(ending, tmp_path):
    faces = {"off": ("3 0 1 3", "3 0 1"), "ply": ("3 0 1 3", "3 0 1"), "obj": ("f 1 2 4", "f 1 2")}
    (tmp_path / f"a.{ending}").write_text(TEXTS[ending].replace(*faces[ending]))
    assert "holds less than it says" in refused(tmp_path / f"a.{ending}")
    # Nor does a longer line elsewhere make up for it.
    (tmp_path / f"b.{ending}").write_text(TEXTS[ending].replace(*faces[ending])[:-1] + " 1\n")
    refused(tmp_path / f"b.{ending}")


def test_an_obj_face_without_corners(tmp_path):
    for number, face in enumerate(("f", "f ", "f 1", "f # 1 2 3")):
        (tmp_path / f"{number}.obj").write_text(f"{OBJ}{face}\n")
        assert "corners" in refused(tmp_path / f"{number}.obj")


def test_the_older_name_of_an_obj_face(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ.replace("f 2 3 4", "fo 2 3 4"))
    assert len(load_mesh(tmp_path / "a.obj")) == 4


def test_polygons_of_more_than_four_corners_beside_triangles(tmp_path):
    text = "OFF\n6 2 0\n0 0 0\n1 0 0\n2 1 0\n1 2 0\n0 2 0\n-1 1 0\n6 0 1 2 3 4 5\n3 0 1 2\n"
    (tmp_path / "a.off").write_text(text)
    assert load_mesh(tmp_path / "a.off").faces.tolist() == [[0, n, n + 1] for n in range(1, 5)] + [[0, 1, 2]]


@pytest.mark.parametrize(
    "text",
    [
        OFF.replace("OFF", "COFF").replace("0 0 1\n", "0 0 1 255 0 0 1\n").replace("3 1 2 3", "3 1 2 3 0.1 0.2 0.3"),
        OFF.replace("OFF\n", "off "),
        OFF.replace("\n", "\r\n"),
        OFF.replace("\n", "\r"),
        OFF.replace("0 0 0\n1 0 0\n", "0 0 0 1 0 0\n"),
        OFF.replace("OFF\n", "OFF # of a test\n# and more\n\n"),
    ],
    ids=["colours", "one line", "CRLF", "CR", "two vertices on a line", "comments"],
)
def test_ways_to_write_off(text, tmp_path):
    (tmp_path / "a.off").write_text(text, newline="")
    assert len(load_mesh(tmp_path / "a.off")) == 4


@pytest.mark.parametrize("text", [OFF.replace("OFF", "4OFF"), OFF.replace("OFF", "OFF BINARY"), OFF[4:]])
def test_off_files_that_are_not_read(text, tmp_path):
    (tmp_path / "a.off").write_text(text)
    refused(tmp_path / "a.off")


@pytest.mark.parametrize("word", ["1,5", "0x10", "1_0", "1.5e", "one"])
@pytest.mark.parametrize("ending", TEXTS)
def test_words_that_are_no_numbers(ending, word, tmp_path):
    (tmp_path / f"a.{ending}").write_text(TEXTS[ending].replace("0 0 1\n", f"0 0 {word}\n"))
    assert f"{word!r} is no number" in refused(tmp_path / f"a.{ending}")


@pytest.mark.parametrize("ending", TEXTS)
def test_corners_that_are_not_whole(ending, tmp_path):
    old, new = ("3 1 2 3", "3 1 2 2.5") if ending != "obj" else ("f 2 3 4", "f 2 3 3.5")
    (tmp_path / f"a.{ending}").write_text(TEXTS[ending].replace(old, new))
    refused(tmp_path / f"a.{ending}")


@pytest.mark.parametrize("module", ["charset_normalizer", "chardet"])
@pytest.mark.parametrize("ending", [*TEXTS, "stl"])
def test_latin_1_needs_no_decoder(ending, module, tmp_path, monkeypatch):
    for name in ("charset_normalizer", "chardet", module):
        monkeypatch.setitem(sys.modules, name, None)
    box: Any = trimesh.creation.box().export(file_type="stl_ascii")
    texts = {
        "obj": f"# M\u00fcller\ng Geh\u00e4use\n{OBJ}",
        "off": OFF.replace("OFF", "OFF # M\u00fcller"),
        "ply": PLY.replace("element vertex", "comment M\u00fcller\nelement vertex"),
        "stl": box.replace("solid ", "solid M\u00fchle ", 1),
    }
    (tmp_path / f"lat.{ending}").write_bytes(texts[ending].encode("latin-1"))
    assert len(load_mesh(tmp_path / f"lat.{ending}")) == (12 if ending == "stl" else 4)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-8-sig"])
@pytest.mark.parametrize("ending", ["off", "obj"])
def test_text_with_a_byte_order_mark(ending, encoding, tmp_path):
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    (tmp_path / f"a.{ending}").write_bytes((mark + TEXTS[ending]).encode(encoding))
    assert len(load_mesh(tmp_path / f"a.{ending}")) == 4


def test_a_text_stl_that_lost_a_corner(tmp_path):
    text: Any = trimesh.creation.box().export(file_type="stl_ascii")
    lines = text.splitlines(keepends=True)
    del lines[next(n for n, line in enumerate(lines) if "vertex" in line)]
    (tmp_path / "a.stl").write_text("".join(lines))
    assert "12 facets, and 35 corners" in refused(tmp_path / "a.stl")


def test_a_text_stl_of_two_solids_in_capitals(tmp_path):
    text: Any = trimesh.creation.box().export(file_type="stl_ascii")
    (tmp_path / "a.stl").write_text(f"{text}\n{text.replace('solid', 'solid facet vertex 1 2 3')}".upper())
    assert len(load_mesh(tmp_path / "a.stl")) == 24


def test_ply_faces_with_texture_coordinates_in_any_order(tmp_path):
    lists = "property list uchar int vertex_indices\n"
    more = f"property uchar kind\nproperty list uchar float texcoord\n{lists}property float area\n"
    rows = ["7 2 0.5 0.5 3 0 2 1 1.5", "7 0 3 0 1 3 1.5", "7 1 0.5 4 0 3 2 1 1.5", "7 0 2 1 2 1.5"]
    text = PLY.replace(lists, more).replace(FACES, "\n".join(rows) + "\n")
    (tmp_path / "a.ply").write_text(text)
    assert load_mesh(tmp_path / "a.ply").faces.tolist() == [[0, 2, 1], [0, 1, 3], [0, 3, 2], [0, 2, 1]]
    (tmp_path / "b.ply").write_text(text.replace(rows[1], "7 0 3 0 1 3"))
    refused(tmp_path / "b.ply")


def test_ply_strips_of_triangles(tmp_path):
    strips = "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(PLY.replace("end_header\n", strips) + "4 0 1 2 3\n")
    assert "strips of triangles" in refused(tmp_path / "a.ply")
