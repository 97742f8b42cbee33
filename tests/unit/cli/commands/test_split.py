"""`sdm split`: near twins and groups stay on one side, and what is trained on a part never sees another."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from sdm.cli import main
from sdm.errors import FormatError, MeshError
from sdm.io.meshes.split_file import read_split
from sdm.shapes import MeshFolder


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """20 ellipsoids; of some a copy that is another triangulation, shifted and turned a little."""
    folder = tmp_path_factory.mktemp("split") / "shapes"
    for number in range(20):
        radii = 1 + np.random.default_rng(number).random(3)
        for copy in range(2 if number % 4 == 0 else 1):
            ball = trimesh.creation.icosphere(3 if copy == 0 else 4)
            ball.apply_transform(np.diag([*radii, 1]))
            if copy:
                ball.apply_transform(trimesh.transformations.rotation_matrix(0.05, [1, 2, 3]))
                ball.apply_translation([3, 0, 1])
            place = folder / f"patient{number // 5}"
            place.mkdir(parents=True, exist_ok=True)
            ball.export(place / f"{number:02}{'-again' if copy else ''}.stl")
    return folder


@pytest.fixture
def folder(made, tmp_path):
    import shutil

    return shutil.copytree(made, tmp_path / "shapes")


def run(*words: object) -> int:
    return main(["split", *map(str, words), "--device", "cpu"])


def test_a_log_says_how_far_it_is(folder, capsys, monkeypatch):
    monkeypatch.setattr("sdm.cli.common.progress.LOG_INTERVAL", 0.0)
    assert run(folder) == 0
    lines = capsys.readouterr().err
    assert "of 25 meshes read" in lines
    assert "pairs compared" in lines
    assert lines.index("meshes read") < lines.index("pairs compared")


def test_near_twins_stay_on_one_side(folder, capsys):
    assert run(folder, "--val", "0.2", "--test", "0.2") == 0
    assert "5 pairs of near twins" in capsys.readouterr().out
    found = json.loads((folder / "split.json").read_text())
    parts = found["parts"]
    assert sorted(name for own in parts.values() for name in own) == sorted(
        path.relative_to(folder).as_posix() for path in folder.rglob("*.stl")
    )
    side = {name: part for part, own in parts.items() for name in own}
    pairs = {frozenset((one, other)) for one, other, _ in found["twins"]}
    assert pairs == {
        frozenset((f"patient{n // 5}/{n:02}.stl", f"patient{n // 5}/{n:02}-again.stl")) for n in range(0, 20, 4)
    }
    assert all(len({side[name] for name in pair}) == 1 for pair in pairs)
    assert all(len(parts[part]) >= 5 for part in ("val", "test"))
    assert run(folder, "--val", "0.2", "--test", "0.2") == 0
    assert json.loads((folder / "split.json").read_text()) == found
    assert run(folder, "--val", "0.2", "--test", "0.2", "--seed", "1", "--twins", "0") == 0
    other = json.loads((folder / "split.json").read_text())
    assert other["parts"] != parts
    assert other["twins"] == []


def test_groups_stay_on_one_side(folder):
    for expression in ("^[^/]+", r"patient(\d+)"):
        assert run(folder, "--group", expression, "--twins", "0") == 0
        parts = read_split(folder)
        patients = {part: {name.partition("/")[0] for name in own} for part, own in parts.items()}
        assert sum(map(len, patients.values())) == 4
        assert all(patients.values())


def test_parts_are_what_families_take(folder):
    assert run(folder, "--val", "0.2", "--test", "0", "--twins", "0") == 0
    parts = read_split(folder)
    assert set(parts) == {"train", "val"}
    train, val = (MeshFolder(folder, split=part) for part in ("train", "val"))
    assert [len(family.meshes) for family in (train, val)] == [len(parts["train"]), len(parts["val"])]
    assert len(train.meshes) + len(val.meshes) == len(MeshFolder(folder).meshes) == 25
    assert train.fingerprint != val.fingerprint
    with pytest.raises(FormatError, match="no part 'test', but"):
        MeshFolder(folder, split="test")
    (folder / parts["val"][0]).unlink()
    with pytest.raises(FormatError, match="1 files of the part 'val'"):
        MeshFolder(folder, split="val")
    with pytest.raises(MeshError, match="a sequence of meshes"):
        MeshFolder(list(train.meshes), split="val")


def test_a_dataset_of_a_part_is_resumed_from_its_name(folder, tmp_path, capsys):
    assert run(folder, "--val", "0.2", "--test", "0", "--twins", "0") == 0
    words = ["generate", str(folder), "-o", str(tmp_path / "d.zarr"), "--split", "val", "--device", "cpu"]
    assert main([*words, "--count", "2", "--resolution", "8"]) == 0
    manifest = json.loads((tmp_path / "d.zarr" / "zarr.json").read_text())["attributes"]["sdm"]
    assert manifest["source"]["split"] == "val"
    assert main(["generate", "-o", str(tmp_path / "d.zarr"), "--verify", "--device", "cpu"]) == 0
    capsys.readouterr()
    assert main(["generate", "cochlea", "-o", str(tmp_path / "e.zarr"), "--split", "val", "--count", "1"]) == 2
    assert "--split is for a folder" in capsys.readouterr().err


def test_bad_meshes_and_bad_words(folder, tmp_path, capsys):
    (folder / "bad.off").write_text("OFF\nthree\n")
    assert run(folder, "--twins", "0") == 2
    assert "bad.off is not used" in capsys.readouterr().err
    assert not (folder / "split.json").exists()
    assert run(folder, "--twins", "0", "--skip-bad", "-o", tmp_path / "s.json") == 0
    assert json.loads((tmp_path / "s.json").read_text())["skipped"][0][0] == "bad.off"
    capsys.readouterr()
    for words, said in (
        (["--val", "0.7", "--test", "0.5"], "leave nothing for train"),
        (["--group", "("], "is no regular expression"),
        (["--group", "zzz", "--twins", "0"], "matches nothing"),
        (["--group", "^.", "--twins", "0"], "too large for these shares"),
    ):
        assert run(folder, "--skip-bad", *words) == 2
        assert said in capsys.readouterr().err
    (folder / "split.json").write_text("{}")
    with pytest.raises(FormatError, match="not a split that"):
        read_split(folder)
