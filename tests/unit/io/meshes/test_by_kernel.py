"""Text meshes read by a kernel are those that are read word by word, and are refused for the same reasons."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from sdm.errors import MeshError
from sdm.io import load_mesh
from sdm.io.meshes import text_rows

TETRAHEDRON = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n{more}"
    "element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
)
CASES = {
    "plain.off": f"OFF\n4 2 0\n{TETRAHEDRON}3 0 1 2\n4 0 1 2 3\n",
    "colours.off": f"OFF # mine\n4 2 0\r\n\r\n{TETRAHEDRON}3 0 1 2 255 0 0\r\n3 0 2 1\rrest of it",
    "short-face.off": f"OFF\n4 2 0\n{TETRAHEDRON}3 0 1 2\n3 0 1\n",
    "short-vertex.off": "OFF\n4 1 0\n0 0 0\n1 0\n0 1 0\n0 0 1\n3 0 1 2\n",
    "half.off": f"OFF\n4 1 0\n{TETRAHEDRON}3 0 1 1.5\n",
    "word.off": f"OFF\n4 1 0\n{TETRAHEDRON}3 0 1 two\n",
    "nan.off": "OFF\n4 1 0\n0 0 0\nnan 0 0\n0 1 0\n0 0 1\n3 0 1 2\n",
    "in-one-line.off": f"OFF\n4 1 0\n{TETRAHEDRON.replace(chr(10), ' ')}3 0 1 2\n",
    "cut.off": f"OFF\n4 4 0\n{TETRAHEDRON}3 0 1 2\n3 0 1\n",
    "many-digits.off": "OFF\n4 1 0\n0 0 0\n0.12345678901234567 0 0\n0 1 0\n0 0 1\n3 0 1 2\n",
    "points.off": f"OFF\n4 0 0\n{TETRAHEDRON}",
    "nothing.off": "OFF\n0 0 0\n",
    "points.obj": "v 0 0 0\nv 1 0 0\n",
    "nothing.obj": "# no line of any use\n",
    "points.ply": PLY.format(more="", faces=0) + TETRAHEDRON,
    "plain.obj": "v 0 0 0\nv 1 0 0 1\nv 0 1 0\n\nvt 0 0\nvn 0 0 1\nf 1/1/1 2//1 3/1\nf -3 -2 -1 # back\n",
    "long.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 \\\n3\n",
    "short.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2\n",
    "zero.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n",
    "slash.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/ 2/ /3\n",
    "bad.obj": "v 0 0 0\nv 1 x 0\nv 0 1 0\nf 1 2 3\n",
    "plain-mixed.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 1 1\nf 1 2 3\nf 1 2 3 4\n",
    "plain-indented.obj": "v 0 0 0\n v 1 0 0\nv 0 1 0\n\n  f 1 2 3\n",
    "plain-older.obj": "v 0 0 0\nv 1 0 0#one\nv 0 1 0\nfo 1 2 3\nfoo 3 2 1\nf\t3 2 1",
    "plain-colours.obj": "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nvn 1 0 0\ng f\n\n\nf 1 2 3",
    "next-line.obj": "v 0 0 0\nv 1 0\n1\nv 0 1 0\nf 1 2 3\n",
    "no-number.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n3\nf 1 2 3\n",
    "beyond.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n",
    "before.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -4\n",
    "plain-blank-lines.off": f"OFF\n\n  \n4 2 0\n\n{TETRAHEDRON}\n3 0 1 2\n\n3 0 2 3\n",
    "plain-triangles.off": f"OFF 4 2 0\n{TETRAHEDRON}3 0 1 2\n3 0 2 3\n# the end",
    "plain-spaces.off": f"OFF\n4 2 0\n{TETRAHEDRON} 3  0 1 2 \n\t3 0 2 3\n",
    "next-line.off": f"OFF\n4 2 0\n{TETRAHEDRON}3 0 1\n2\n3 0 1 2\n",
    "plain.ply": PLY.format(more="property uchar red\n", faces=2)
    + "0 0 0 1\n1 0 0 2\n0 1 0 3\n0 0 1 4\n3 0 1 2\n4 0 1 2 3\n",
    "short.ply": PLY.format(more="", faces=2) + TETRAHEDRON + "3 0 1 2\n3 0 1\n",
    "cut.ply": PLY.format(more="", faces=2) + TETRAHEDRON + "3 0 1 2\n",
    "hex.ply": PLY.format(more="", faces=1) + TETRAHEDRON + "3 0 1 0x2\n",
}


def outcome(path, monkeypatch, by_kernel: bool):
    monkeypatch.setattr(text_rows, "LARGE", 0)
    monkeypatch.setattr(text_rows, "LARGEST", (1 << 31) - 2 if by_kernel else 0)
    try:
        mesh = load_mesh(path)
    except MeshError as error:
        return str(error)
    return [array.tolist() for array in mesh.numpy()]


@pytest.mark.parametrize("name", CASES)
def test_the_same_mesh_or_sentence(name, tmp_path, monkeypatch):
    path = tmp_path / name
    path.write_bytes(CASES[name].encode())
    slow = outcome(path, monkeypatch, False)
    assert outcome(path, monkeypatch, True) == slow
    good = name.startswith("plain")
    assert isinstance(slow, list) == (good or name.split(".")[0] in ("colours", "in-one-line", "many-digits", "long"))


@pytest.mark.parametrize("ending", ["off", "obj", "ply"])
def test_a_larger_mesh(ending, tmp_path, monkeypatch):
    ball = trimesh.creation.icosphere(3)
    ball.apply_transform(trimesh.transformations.rotation_matrix(0.3, [1, 2, 3]))
    path = tmp_path / f"ball.{ending}"
    ball.export(path, **({"encoding": "ascii"} if ending == "ply" else {}))
    slow, fast = (outcome(path, monkeypatch, by_kernel) for by_kernel in (False, True))
    assert len(slow[1]) == len(ball.faces)
    for one, other in zip(slow, fast, strict=True):
        np.testing.assert_array_equal(one, other)


def test_without_warp_small_files_are_read_word_by_word(monkeypatch):
    monkeypatch.setattr(text_rows, "sys", type("Sys", (), {"modules": {}}))
    assert text_rows.ScannedLines.of(b"1 2 3\n") is None
