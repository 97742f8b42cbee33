from __future__ import annotations

import io
from contextlib import redirect_stdout

import numpy as np
import pytest
import trimesh

import sdm
from sdm.cli.commands.demo import demo
from sdm.core.demo_mesh import demo_mesh
from sdm.errors import DeviceError, FormatError, GridError
from sdm.surrogate import shipped_weights


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder that a demo has made, and what it has said."""
    folder = tmp_path_factory.mktemp("demo") / "a" / "b"
    with redirect_stdout(io.StringIO()) as said:
        demo(resolution=40, out=folder)
    return folder, said.getvalue()


def test_writes_mesh_map_and_picture_and_says_so(made):
    folder, said = made
    more = [] if shipped_weights() is None else ["surrogate.png"]
    assert sorted(path.name for path in folder.iterdir()) == ["demo.nii.gz", "demo.ply", "demo.png", *more]
    assert "20,256 triangles" in said
    assert "40 x 40 x 40 voxels" in said
    assert str(folder / "demo.nii.gz") in said


def test_the_files_hold_the_mesh_and_its_map(made):
    folder, _ = made
    mesh = sdm.load_mesh(folder / "demo.ply")
    np.testing.assert_array_equal(mesh.numpy()[0], demo_mesh().numpy()[0])
    field = sdm.load(folder / "demo.nii.gz")
    points = field.grid.points().reshape(-1, 3)
    np.testing.assert_allclose(sdm.signed_distance(mesh, points), field.values.reshape(-1), atol=1e-5)
    voxel = np.prod(field.grid.spacing)
    vertices, faces = demo_mesh().numpy()
    assert int((field.values < 0).sum()) * voxel == pytest.approx(trimesh.Trimesh(vertices, faces).volume, rel=0.03)


def test_bad_wishes_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(GridError, match="resolution"):
        demo(resolution=0, out=tmp_path / "x")
    with pytest.raises(DeviceError, match="no device called"):
        demo(resolution=8, out=tmp_path / "x", device="abacus")
    assert not (tmp_path / "x").exists()


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FormatError, match="cannot be made"):
        demo(resolution=8, out=tmp_path / "file" / "demo")
