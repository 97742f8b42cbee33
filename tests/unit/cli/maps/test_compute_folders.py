"""`sdm compute` over nested folders: the tree is kept, numbers are those of single calls, a bad mesh stops nothing."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

import sdm
from sdm.cli import main
from sdm.cli.common.output_files import inputs_of, places_in
from sdm.cli.maps.run import run as run_jobs
from sdm.core.normalization import Normalization
from tests.helpers.map_settings import map_settings
from tests.helpers.processes.killed_command import killed_after

SMALL = ["--resolution", "12", "--device", "cpu"]
BALL = trimesh.creation.icosphere(1)


@pytest.fixture
def shapenet(tmp_path):
    """Meshes that are all called alike, one of them bad, one open."""
    root = tmp_path / "ShapeNet"
    for number, place in enumerate(("02691156/aa", "02691156/bb", "03001627/cc", "03001627/dd")):
        folder = root / place / "models"
        folder.mkdir(parents=True)
        ball = BALL.copy()
        ball.apply_scale([1, 1 + 0.2 * number, 1])
        if number == 3:
            ball = trimesh.Trimesh(ball.vertices, ball.faces[:-9], process=False)
        ball.export(folder / "model_normalized.obj")
    (root / "03001627" / "bad").mkdir()
    (root / "03001627" / "bad" / "model.off").write_text("OFF\nthree\n")
    (root / ".hidden").mkdir()
    BALL.export(root / ".hidden" / "no.stl")
    return root


def run(*words: object) -> int:
    return main(["compute", *map(str, words)])


def test_the_tree_is_kept_and_numbers_are_those_of_single_calls(shapenet, tmp_path, capsys):
    out = tmp_path / "maps"
    assert run(shapenet, "-o", out, *SMALL, "--format", "npz", "--skip-bad") == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0].startswith("02691156/aa/models/model_normalized.obj: 80 triangles")
    assert table[-1] == "5 meshes: 4 done, 1 failed, 1 with warnings"
    assert "bad/model.off" in table[-2]
    files = sorted(path.relative_to(out) for path in out.rglob("*.npz"))
    assert [str(path) for path in files[:2]] == [
        "02691156/aa/models/model_normalized.npz",
        "02691156/bb/models/model_normalized.npz",
    ]
    assert len(files) == 4
    for file in files:
        mesh = sdm.load_mesh((shapenet / file).with_suffix(".obj"))
        expected = sdm.signed_distance_map(mesh, resolution=12, device="cpu")
        found = sdm.load(out / file)
        assert (found.grid, found.ambiguous_voxels) == (expected.grid, expected.ambiguous_voxels)
        np.testing.assert_array_equal(found.numpy(), expected.numpy())
    report = json.loads((out / "report.json").read_text())
    states = {Path(entry["mesh"]).parts[-2]: entry for entry in report["meshes"] if entry["state"] == "failed"}
    assert list(states) == ["bad"]
    assert "cannot be read" in states["bad"]["reason"]
    done = next(entry for entry in report["meshes"] if "dd" in entry["mesh"])
    assert (done["triangles"], done["closed"], done["sign"]) == (71, False, "winding")
    assert done["warnings"]
    assert set(report["seconds_of_stages"]) == {"read", "cpu", "write"}
    assert run(shapenet, "-o", out, *SMALL, "--format", "npz", "--skip-bad", "--resume") == 0
    assert "4 there already, 1 failed" in capsys.readouterr().out


def test_files_called_alike_lie_as_below_their_common_folder(shapenet, tmp_path):
    meshes = sorted(shapenet.glob("*/*/models/*.obj"))
    assert run(*meshes, "-o", tmp_path / "maps", *SMALL) == 0
    names = sorted(str(path.relative_to(tmp_path / "maps")) for path in (tmp_path / "maps").rglob("*.nii.gz"))
    assert names == [f"{p.parent.relative_to(shapenet)}/model_normalized.nii.gz" for p in meshes]
    two = inputs_of([shapenet / "02691156", shapenet / "03001627"])
    assert len(set(places_in(two))) == len(two) == 5


def test_names_that_end_twice_are_of_two_maps():
    names = ["x.ply", "x.stl", "x.ply.ply", "x.ply.ply.ply", "y.ply", "y.ply.ply"]
    places = [str(place) for place in places_in({Path("in", name): Path(name) for name in names})]
    assert places == ["x.ply", "x.stl", "x.ply.ply", "x.ply.ply.ply", "y", "y.ply"]


def test_a_link_that_leads_back_ends(shapenet):
    os.symlink(shapenet, shapenet / "02691156" / "up")
    assert len(sdm.io.mesh_tree(shapenet)) == 5


@pytest.mark.parametrize("ending", ["nii.gz", "zarr"])
def test_the_number_of_workers_changes_no_byte(shapenet, tmp_path, ending, capsys):
    sources = sorted(shapenet.glob("*/*/models/*.obj")) * 2
    contents = []
    for workers in (1, 3):
        out = tmp_path / f"{workers}"
        out.mkdir()
        jobs = [(source, out / f"{number}.{ending}") for number, source in enumerate(sources)]
        assert run_jobs(jobs, map_settings(10), workers=workers) is None
        contents.append({path.relative_to(out): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()})
    assert contents[0] == contents[1]
    said = capsys.readouterr().out.splitlines()
    assert [line.rpartition("/")[2] for line in said[:8]] == [f"{n}.{ending}" for n in range(8)]


@pytest.mark.parametrize("ending", ["npz", "zarr"])
def test_half_precision_truncation_and_normalisation(shapenet, tmp_path, ending):
    source = shapenet / "02691156/bb/models/model_normalized.obj"
    more = ["--dtype", "float16", "--truncate", "0.3", "--normalize", "sphere"]
    # One alone is streamed, of a folder each is a map of its own.
    assert run(source, "-o", tmp_path / f"one.{ending}", *SMALL, *more) == 0
    assert run(shapenet / "02691156", "-o", tmp_path / "all", "--format", ending, *SMALL, *more) == 0
    mesh = sdm.load_mesh(source)
    by = Normalization.of(mesh, "sphere")
    expected = sdm.signed_distance_map(by.normalised(mesh), resolution=12, device="cpu")
    values = expected.values.clamp(-0.3, 0.3).half().float()
    for path in (tmp_path / f"one.{ending}", tmp_path / "all" / "bb" / "models" / f"model_normalized.{ending}"):
        found = sdm.load(path)
        assert (found.normalization, found.truncated, found.grid) == (by, 0.3, expected.grid)
        np.testing.assert_array_equal(found.numpy(), values.numpy())
    for options, there in ((more, True), ([], False), (["--normalize", "sphere"], False)):
        before = (tmp_path / f"one.{ending}").stat().st_mtime_ns
        assert run(source, "-o", tmp_path / f"one.{ending}", *SMALL, *options, "--resume") == 0
        assert ((tmp_path / f"one.{ending}").stat().st_mtime_ns == before) == there


def test_what_cannot_be_is_refused(shapenet, tmp_path, capsys):
    source = shapenet / "02691156/bb/models/model_normalized.obj"
    for words, said in (
        (["-o", tmp_path / "x.nii.gz", "--dtype", "float16"], "cannot hold float16: use .npz or .zarr"),
        (["-o", tmp_path / "x.npz", "--truncate", "-1"], "--truncate is -1"),
        (["-o", tmp_path / "x.npz", "--dtype", "float16", "--scale", "1e6"], "float16 ends at 65504"),
        (["-o", tmp_path / "x.npz", "--dtype", "float16", "--scale", "1e-8"], "too small for float16"),
        (["-o", tmp_path / "x.npz", "--dtype", "float16", "--truncate", "1e-8"], "distances of 1e-08 are too small"),
        (["-o", tmp_path / "x.nvdb", "--normalize", "cube"], "no room"),
        (["-o", tmp_path / "x.npz", "--report", tmp_path / "no" / "r.json"], "is not there"),
        (["-o", tmp_path / "x.npz", "--report", source], "is an input too"),
    ):
        assert run(source, *SMALL, *words) == 2
        assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("x.*"))


def test_a_format_without_room_is_refused_before_any_mesh_is_read(shapenet, tmp_path, capsys):
    for words, said in (
        (["--format", "nvdb", "--normalize", "cube"], "no room for what a mesh was normalised by"),
        (["--format", "vti", "--dtype", "float16"], "cannot hold float16"),
        (["--format", "nii", "--band", "3"], "narrow band"),
    ):
        assert run(shapenet, "-o", tmp_path / "maps", *SMALL, *words, "--skip-bad") == 2
        captured = capsys.readouterr()
        assert said in captured.err
        assert (len(captured.err.splitlines()), captured.out) == (1, "")
    assert not [path for path in (tmp_path / "maps").rglob("*") if path.is_file()]


def test_a_mesh_far_from_the_image_is_too_far_for_half_precision(shapenet, tmp_path, capsys):
    """The grid is small, but distances on it are not: they came to be infinite in the file."""
    source = shapenet / "02691156/bb/models/model_normalized.obj"
    sdm.save(sdm.signed_distance_map(source, 5, device="cpu"), tmp_path / "here.npz")
    mesh = sdm.load_mesh(source)
    sdm.save_mesh(sdm.TriangleMesh(mesh.vertices + 1e5, mesh.faces), tmp_path / "far.ply")
    more = ["--grid-like", tmp_path / "here.npz", "--device", "cpu", "--dtype", "float16"]
    assert run(tmp_path / "far.ply", "-o", tmp_path / "x.npz", *more) == 2
    assert "distances on this grid may reach 173208" in capsys.readouterr().err
    assert run(tmp_path / "far.ply", "-o", tmp_path / "x.npz", *more, "--truncate", "2") == 0
    assert sdm.load(tmp_path / "x.npz").numpy().max() == 2


def test_a_full_disk_is_one_sentence(shapenet, tmp_path, capsys, monkeypatch):
    import pathlib

    whole = pathlib.Path.open

    def no_room(self, mode="r", *more, **options):
        if "w" in mode and self.name.startswith(".model_normalized"):
            raise OSError(28, "No space left on device", str(self))
        return whole(self, mode, *more, **options)

    monkeypatch.setattr(pathlib.Path, "open", no_room)
    assert run(shapenet, "-o", tmp_path / "maps", *SMALL, "--format", "npz", "--skip-bad") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "No space left on device; --resume goes on from there" in line
    assert not [path for path in (tmp_path / "maps").rglob("*") if path.is_file()]


def test_kill_9_leaves_no_broken_map_and_is_resumed_to_the_same_bytes(tmp_path):
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    for number in range(80):
        BALL.export(folder / f"{number}.stl")
    words = ["compute", str(folder), "--resolution", "40", "--device", "cpu", "--format", "npz", "-o"]
    killed_after([*words, str(out)], out, "[0-9]*.npz")
    there = sorted(out.glob("[0-9]*.npz"))
    expected = sdm.signed_distance_map(folder / "0.stl", resolution=40, device="cpu").numpy()
    for path in there:
        np.testing.assert_array_equal(sdm.load(path).numpy(), expected)
    before = {path: path.stat().st_mtime_ns for path in there}
    assert main([*words, str(out), "--resume"]) == 0
    assert len(list(out.glob("[0-9]*.npz"))) == 80
    assert {path: path.stat().st_mtime_ns for path in there} == before


def test_a_mesh_that_is_named_twice_in_other_words_is_one(shapenet, monkeypatch):
    monkeypatch.chdir(shapenet)
    folder = Path("02691156")
    once = inputs_of([folder])
    again = [shapenet / folder, Path("../", shapenet.name, folder), *(shapenet / file for file in once)]
    assert inputs_of([folder, *again]) == once
