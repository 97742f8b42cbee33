"""The command that writes datasets."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

from sdm.cli import main
from sdm.cli.common.progress import CountProgress
from sdm.core.demo_mesh import demo_mesh
from sdm.dataset import SDMDataset, shard_stage
from sdm.shapes import Cochlea, MeshFolder
from sdm.stream import SDMStream

SMALL = ["--count", "5", "--resolution", "10", "--device", "cpu", "--shard", "2"]


def run(*words: object) -> int:
    return main(["generate", *map(str, words)])


@pytest.fixture
def folder(tmp_path) -> Path:
    import trimesh

    made = tmp_path / "meshes"
    made.mkdir()
    for name, mesh in (
        ("one.ply", demo_mesh(rings=41, segments=16, cap_rings=3)),
        ("two.stl", Cochlea(600).mesh([3, 0.5, 0.1, 0])),
    ):
        trimesh.Trimesh(*mesh.numpy(), process=False).export(made / name)
    return made


def test_writes_what_the_stream_yields(tmp_path, capsys):
    out = tmp_path / "cochlea.zarr"
    assert (
        run("cochlea", "--triangles", 600, *SMALL, "--seed", 7, "--dtype", "float16", "--truncate", 2, "-o", out) == 0
    )
    said = capsys.readouterr()
    assert re.search(r"cochlea.zarr: 5 maps of cochlea, 10 x 10 x 10 voxels of 1\.\d+, 0\.\d MiB", said.out)
    assert said.err == ""
    family = Cochlea(600)
    stream = SDMStream(family, family.grid(10), 5, 7, device="cpu", dtype=torch.float16, truncate=2.0)
    batch = next(iter(stream))
    data = SDMDataset(out)
    assert torch.equal(torch.stack([data[i].sdm for i in range(5)]), batch.sdm)
    assert data.manifest["source"] == {"family": "cochlea", "triangles": 600}


def test_a_folder_of_meshes(tmp_path, folder, capsys):
    out = tmp_path / "d.zarr"
    assert run(folder, *SMALL, "--warp", 0.2, "--scale", 1, 2, "-o", out) == 0
    family = MeshFolder(folder, warp=0.2, scale=(1.0, 2.0))
    batch = next(iter(SDMStream(family, family.grid(10), 5, device="cpu")))
    data = SDMDataset(out)
    assert torch.equal(torch.stack([data[i].sdm for i in range(5)]), batch.sdm)


def test_bad_files_are_listed_and_never_skipped_silently(tmp_path, folder, capsys):
    (folder / "broken.ply").write_text("ply\n")
    (folder / "text.obj").write_text("v 0 0 0\n")
    out = tmp_path / "d.zarr"
    assert run(folder, *SMALL, "-o", out) == 2
    said = capsys.readouterr().err
    assert "broken.ply is not used: " in said
    assert "text.obj is not used: " in said
    assert "2 files of" in said
    assert "--skip-bad" in said
    assert not list(tmp_path.glob("d.zarr*"))
    assert run(folder, *SMALL, "--skip-bad", "-o", out) == 0
    assert "broken.ply is not used: " in capsys.readouterr().err
    assert [name for name, _ in SDMDataset(out).manifest["rejected"]] == ["broken.ply", "text.obj"]


def test_meshes_with_holes_are_kept_if_one_says_so(tmp_path, folder, capsys):
    import trimesh

    whole = trimesh.creation.icosphere(2)
    trimesh.Trimesh(whole.vertices, whole.faces[5:], process=False).export(folder / "zopen.ply")
    out = tmp_path / "d.zarr"
    assert run(folder, *SMALL, "-o", out) == 2
    said = capsys.readouterr().err
    assert "zopen.ply is not used: it has holes" in said
    assert "by --open-meshes keep" in said
    assert "sdm: 1 file of" in said
    assert run(folder, *SMALL, "--open-meshes", "keep", "-o", out) == 0
    assert SDMDataset(out).manifest["source"]["open_meshes"] == "keep"
    assert SDMDataset(out).theta[:, 0].max() > 2
    shard = out / "sdm/c/0/0/0/0"
    content = shard.read_bytes()
    shard.unlink()
    # The family is made again from the manifest, holes and all.
    assert run("--verify", "-o", out, "--device", "cpu") == 0
    assert shard.read_bytes() == content


def test_meshes_are_turned_and_signed_as_one_says(tmp_path, folder, capsys):
    out = tmp_path / "d.zarr"
    words = ["--sign", "flood", "--hole-size", "0.2", "--orient", "parts", "--open-meshes", "keep"]
    assert run(folder, *SMALL, *words, "-o", out) == 0
    data = SDMDataset(out)
    assert data.manifest["source"]["orient"] == "parts"
    assert (data.manifest["recipe"]["sign"], data.manifest["recipe"]["hole_size"]) == ("flood", 0.2)
    family = MeshFolder(folder, orient="parts", open_meshes="keep")
    stream = SDMStream(family, family.grid(10), 5, device="cpu", sign="flood", hole_size=0.2)
    assert torch.equal(torch.stack([data[i].sdm for i in range(5)]), next(iter(stream)).sdm)
    capsys.readouterr()
    assert run("ellipsoid", *SMALL, "--orient", "parts", "-o", tmp_path / "e.zarr") == 2
    assert "--orient is for a folder of meshes" in capsys.readouterr().err


def test_doubled_walls_and_holes_under_a_flood(tmp_path, capsys):
    import trimesh

    ball = trimesh.creation.icosphere(2)
    walls, out = tmp_path / "walls", tmp_path / "d.zarr"
    walls.mkdir()
    ball.export(walls / "b.ply")
    ball.faces = [*ball.faces, *ball.faces[:, ::-1]]
    ball.export(walls / "a.ply")
    assert run(walls, *SMALL, "--skip-bad", "-o", tmp_path / "w.zarr") == 0
    assert "a.ply is not used: it is closed but encloses no volume" in (said := capsys.readouterr().err)
    assert "--sign flood" in said
    assert run(walls, *SMALL, "--sign", "flood", "-o", out) == 0
    assert capsys.readouterr().err == ""
    data = SDMDataset(out)
    assert data.manifest["source"]["sign"] == "flood"
    assert all(int((data[i].sdm < 0).sum()) > 20 for i in range(5))
    # The family is made again from the manifest, and from the folder.
    (out / "sdm/c/0/0/0/0").unlink()
    assert run("--verify", "-o", out, "--device", "cpu") == 0
    (out / "sdm/c/1/0/0/0").unlink()
    assert run(walls, "--verify", "-o", out, "--device", "cpu") == 0
    (walls / "b.ply").unlink()
    assert run(walls, *SMALL, "--skip-bad", "-o", tmp_path / "n.zarr") == 2
    assert "no mesh to use: a.ply cannot be used: it is closed but encloses no volume" in capsys.readouterr().err


def test_resume_and_verify_need_no_more_than_the_name(tmp_path, folder, monkeypatch, capsys):
    whole, out = tmp_path / "whole.zarr", tmp_path / "d.zarr"
    assert run(folder, *SMALL, "-o", whole) == 0
    real = shard_stage.write_shard

    def stop_at_1(*args):
        if args[2] == 1:
            raise KeyboardInterrupt
        real(*args)

    monkeypatch.setattr(shard_stage, "write_shard", stop_at_1)
    assert run(folder, *SMALL, "-o", out) == 130
    monkeypatch.undo()
    capsys.readouterr()
    assert run(folder, *SMALL, "-o", out) == 2
    assert "--resume finishes it" in capsys.readouterr().err
    assert run("--resume", "-o", out, "--device", "cpu") == 0
    for number in range(5):
        assert torch.equal(SDMDataset(out)[number].sdm, SDMDataset(whole)[number].sdm)
    shard = out / "sdm/c/2/0/0/0"
    content = shard.read_bytes()
    shard.write_bytes(content[:-1])
    capsys.readouterr()
    assert run("--verify", "-o", out, "--device", "cpu") == 0
    assert "1 of 3 shards were damaged and have been made again: 2" in capsys.readouterr().out
    assert shard.read_bytes() == content
    assert run("--verify", "-o", out, "--device", "cpu") == 0
    assert "all 3 shards are sound" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["cochlear", *SMALL], "cochlear is neither a family (cochlea, cuboid,"),
        ([*SMALL], "say what to generate"),
        (["cochlea", "--resolution", "8"], "say how many samples: --count"),
        (["cochlea", *SMALL, "--warp", "0.1"], "--warp is for a folder of meshes"),
        (["cochlea", *SMALL, "--sampler", "halton"], "there is no sampler called 'halton'"),
        (["cochlea", "--count", "0"], "0 samples"),
        (["--verify"], "is not a dataset that sdm generate wrote"),
        (["--resume"], "is not a dataset that sdm generate wrote"),
        (["cochlea", *SMALL, "--device", "tpu"], "no device called 'tpu'"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(tmp_path, capsys, words, message):
    assert run(*words, "-o", tmp_path / "d.zarr") == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("out", [".", "/"])
@pytest.mark.parametrize("words", [["cuboid", *SMALL], ["cuboid", *SMALL, "--resume"], ["--resume"]])
def test_a_dataset_without_a_name(tmp_path, monkeypatch, capsys, words, out):
    monkeypatch.chdir(tmp_path)
    assert run(*words, "-o", out) == 2
    assert "is no name for a dataset" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("family", [["cuboid"], []], ids=["with the family", "from the name"])
def test_resume_refuses_what_the_dataset_is_not(tmp_path, capsys, family):
    out = tmp_path / "d.zarr"
    own = [*SMALL, "--seed", "3", "--compression", "none", "--margin", "0.1", "--truncate", "1"]
    assert run("cuboid", *own, "-o", out) == 0
    for words, message in (
        (["--count", "100"], "has count 5, but 100 was requested"),
        (["--resolution", "32"], "but 32 x 32 x 32 voxels of "),
        (["--margin", "0.2"], "has grid 10 x 10 x 10 voxels of "),
        (["--seed", "0"], "has seed 3, but 0"),
        (["--sampler", "sobol"], "has sampler uniform, but sobol"),
        (["--dtype", "float16"], "has dtype float32, but float16"),
        (["--truncate", "2"], "has truncate 1.0, but 2.0"),
        (["--shard", "3"], "has shard 2, but 3"),
        (["--compression", "zstd"], "has compression none, but zstd"),
        (["--warp", "0.1"], "--warp is for a folder of meshes"),
    ):
        capsys.readouterr()
        given = [*family, *own, *words] if family else words
        assert run("--resume", *given, "--device", "cpu", "-o", out) == 2
        said = capsys.readouterr().err
        assert message in said
        assert said.count("\n") == 1
    assert run("--resume", *family, *own, "-o", out) == 0
    assert run("--resume", "--count", "5", "--resolution", "10", *(own if family else []), *family, "-o", out) == 0


def test_what_is_left_out_beside_the_family_is_what_the_dataset_was_begun_with(tmp_path, capsys):
    out = tmp_path / "d.zarr"
    assert run("cochlea", *SMALL, "--triangles", "600", "--seed", "3", "-o", out) == 0
    assert run("cochlea", "--resume", "--device", "cpu", "-o", out) == 0
    assert run("cochlea", "--triangles", "600", "--count", "5", "--resume", "--device", "cpu", "-o", out) == 0
    capsys.readouterr()
    assert run("cochlea", "--triangles", "900", "--resume", "--device", "cpu", "-o", out) == 2
    assert "cochlea is not what" in capsys.readouterr().err
    assert run("cuboid", "--resume", "--device", "cpu", "-o", out) == 2
    assert "has family cochlea, but cuboid was requested" in capsys.readouterr().err


def test_progress_in_a_log(monkeypatch, capsys):
    clock = iter([0.0, 10.0, 40.0, 100.0])
    monkeypatch.setattr("sdm.cli.common.progress.time.monotonic", lambda: next(clock))
    with CountProgress("maps") as progress:
        for done in (100, 200, 500, 1100):
            progress(done, 10_100)
    assert capsys.readouterr().err.splitlines() == [
        "sdm: 500 of 10,100 maps, 10 a second, 0:16:00 left",
        "sdm: 1,100 of 10,100 maps, 10 a second, 0:15:00 left",
    ]


def test_the_family_by_its_option(tmp_path, capsys, folder):
    ends = []
    for number, words in enumerate((["cochlea"], ["--family", "cochlea"])):
        out = tmp_path / f"{number}.zarr"
        assert run(*words, "--triangles", 600, *SMALL, "-o", out) == 0
        ends.append(SDMDataset(out))
    assert torch.equal(ends[0][3].sdm, ends[1][3].sdm)
    assert ends[0].manifest == ends[1].manifest
    capsys.readouterr()
    for words, said in (
        (["cochlea", "--family", "cuboid"], "cochlea and --family cuboid both say what to generate: give one of them"),
        (["--family", folder], f"--family takes a family; give the folder of meshes in the first place: {folder}"),
        (["--family", "snail"], "snail is neither a family"),
    ):
        assert run(*words, *SMALL, "-o", tmp_path / "none.zarr") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert said in line
        assert not (tmp_path / "none.zarr").exists()
