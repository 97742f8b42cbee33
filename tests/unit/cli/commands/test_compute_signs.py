from __future__ import annotations

import numpy as np
import pytest
import trimesh

import sdm
from sdm.cli import main

BALL = trimesh.creation.icosphere(2)
SMALL = ["--resolution", "14", "--device", "cpu"]


@pytest.fixture
def bowl(tmp_path):
    half = BALL.copy()
    half.update_faces(half.triangles_center[:, 2] < 0)
    half.export(tmp_path / "bowl.ply")
    return tmp_path / "bowl.ply"


def run(*words: object) -> int:
    return main(["compute", *map(str, words)])


@pytest.mark.parametrize("ending", ["npz", "zarr"])
def test_maps_are_signed_as_the_option_says(ending, bowl, tmp_path, capsys):
    mesh = sdm.load_mesh(bowl)
    index, grid = sdm.MeshIndex(mesh, "cpu", warn=False), sdm.Grid.around(mesh, 14)
    out = tmp_path / f"map.{ending}"
    for words, asked in (
        (["--sign", "flood", "--hole-size", "2.2"], {"sign": "flood", "hole_size": 2.2}),
        (["--sign", "none"], {"sign": "none"}),
        ([], {"sign": "winding"}),
    ):
        assert run(bowl, "-o", out, *SMALL, *words) == 0
        found, expected = sdm.load(out), index.signed_distance_map(grid, **asked)
        assert np.array_equal(found.numpy(), expected.numpy())
        assert (found.sign, found.hole_size) == (expected.sign, expected.hole_size)
        assert (found.inside_voxels > 0) == (words[1:2] != ["none"])
        if words:
            assert "warning" not in capsys.readouterr().err


def test_a_flood_that_comes_everywhere_says_so(bowl, tmp_path, capsys):
    assert run(bowl, "-o", tmp_path / "map.npz", *SMALL, "--sign", "flood", "--hole-size", "0.3") == 0
    assert "the flood comes everywhere" in capsys.readouterr().err


def test_a_hole_size_without_a_flood_is_refused(bowl, tmp_path, capsys):
    assert run(bowl, "-o", tmp_path / "map.npz", *SMALL, "--hole-size", "0.3") == 2
    assert "sdm: hole_size is the width of gaps for sign='flood'" in capsys.readouterr().err
    assert not (tmp_path / "map.npz").exists()


def test_resume_makes_a_map_again_that_was_signed_otherwise(bowl, tmp_path, capsys):
    out = tmp_path / "map.npz"
    for words, said in (
        (["--sign", "flood"], "written to"),
        (["--sign", "flood"], "is there already"),
        (["--sign", "flood", "--hole-size", "2.5"], "written to"),
        ([], "written to"),
        (["--sign", "none"], "written to"),
    ):
        assert run(bowl, "-o", out, *SMALL, "--resume", *words) == 0
        assert said in capsys.readouterr().out


def test_inspect_recommends_a_sign(bowl, capsys):
    assert main(["inspect", str(bowl)]) == 0
    out = capsys.readouterr().out
    assert "recommended sign" in out
    assert "none: the mesh is one sheet" in out
