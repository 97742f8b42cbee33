from __future__ import annotations

import pytest
import torch
import trimesh

import sdm
from sdm.cli import main
from sdm.io import grid_like, load_band, load_mesh
from sdm.io.maps.save_and_load import made_from

BALL = trimesh.creation.icosphere(1)
SMALL = ["--resolution", "20", "--device", "cpu"]


@pytest.fixture
def ball(tmp_path):
    BALL.export(tmp_path / "ball.stl")
    return tmp_path / "ball.stl"


def run(*words: object) -> int:
    return main(["compute", *map(str, words)])


@pytest.mark.parametrize("ending", ["npz", "zarr", "nvdb"])
def test_one_mesh_to_one_band(ending, ball, tmp_path, capsys):
    out = tmp_path / f"band.{ending}"
    assert run(ball, "-o", out, "--band", 2, *SMALL) == 0
    found = load_band(out)
    mesh = load_mesh(ball)
    wanted = sdm.narrow_band(mesh, sdm.Grid.around(mesh, resolution=20), half_width=2, device="cpu")
    assert torch.equal(found.values, wanted.values)
    assert found.inside_voxels == int((wanted.to_dense().values < 0).sum())
    assert grid_like(out) == wanted.grid
    assert made_from(out) is not None
    # The same once more is left; another width is another file.
    before = out.stat().st_mtime_ns
    assert run(ball, "-o", out, "--band", 2, "--resume", *SMALL) == 0
    assert out.stat().st_mtime_ns == before
    assert run(ball, "-o", out, "--band", 3, "--resume", *SMALL) == 0
    assert load_band(out).half_width == pytest.approx(3)


def test_a_folder_of_bands(tmp_path, capsys):
    (tmp_path / "meshes").mkdir()
    for name in ("a.stl", "b.ply"):
        BALL.export(tmp_path / "meshes" / name)
    assert run(tmp_path / "meshes", "-o", tmp_path / "bands", "--band", 3, *SMALL) == 0
    assert {path.name for path in (tmp_path / "bands").iterdir()} == {"a.npz", "b.npz"}
    assert len(load_band(tmp_path / "bands" / "a.npz")) > 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--hole-size", "0.1"], "hole_size is the width of gaps"),
        (["--truncate", "1"], "are for maps"),
        (["--format", "nrrd"], "no place for a narrow band"),
    ],
)
def test_what_bands_cannot_be(words, said, ball, tmp_path, capsys):
    assert run(ball, "-o", tmp_path / "bands", "--band", 3, *words, *SMALL) == 2
    assert said in capsys.readouterr().err
