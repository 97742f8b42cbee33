"""GIfTI and FreeSurfer surfaces: as nibabel reads and writes them, and damaged."""

from __future__ import annotations

import nibabel as nib
import numpy as np
import pytest

import sdm
from sdm.bench.common.meshes import cube

VERTICES, FACES = cube()
MESH = sdm.TriangleMesh(VERTICES, FACES)


def test_freesurfer_as_nibabel(tmp_path):
    nib.freesurfer.write_geometry(tmp_path / "lh.pial", VERTICES, FACES, "somebody, somewhen")
    mesh = sdm.load_mesh(tmp_path / "lh.pial")
    np.testing.assert_array_equal(mesh.vertices, VERTICES)
    np.testing.assert_array_equal(mesh.faces, FACES)
    MESH.save(tmp_path / "rh.white")
    vertices, faces = nib.freesurfer.read_geometry(tmp_path / "rh.white")
    np.testing.assert_array_equal(vertices, VERTICES)
    np.testing.assert_array_equal(faces, FACES)


def test_gifti_as_nibabel(tmp_path):
    MESH.save(tmp_path / "lh.surf.gii")
    points, triangles = nib.load(tmp_path / "lh.surf.gii").agg_data(("pointset", "triangle"))
    np.testing.assert_array_equal(points, VERTICES)
    np.testing.assert_array_equal(triangles, FACES)
    assert sdm.signed_distance(tmp_path / "lh.surf.gii", [[0.0, 0, 0]], device="cpu").tolist() == [-1]


def test_damage(tmp_path):
    MESH.save(tmp_path / "lh.pial")
    data = (tmp_path / "lh.pial").read_bytes()
    for name, bad, message in (
        ("cut.pial", data[:-5], "holds less than it says"),
        ("quads.pial", b"\xff\xff\xff" + data[3:], "of quads: convert it"),
        ("other.pial", b"hello there", "damaged, or not what its name says"),
        ("short.pial", data[:20], "damaged, or not what its name says"),
        ("index.pial", data[:-1] + b"\x7f", "a face of .* uses vertex"),
        ("bad.gii", b"<GIFTI>", "damaged, or not what its name says"),
    ):
        (tmp_path / name).write_bytes(bad)
        with pytest.raises(sdm.MeshError, match=message):
            sdm.load_mesh(tmp_path / name)
    values = nib.gifti.GiftiImage(darrays=[nib.gifti.GiftiDataArray(np.zeros(3, np.float32))])
    nib.save(values, tmp_path / "values.func.gii")
    with pytest.raises(sdm.MeshError, match="0 pointsets and 0 sets of triangles"):
        sdm.load_mesh(tmp_path / "values.func.gii")
