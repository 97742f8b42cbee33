"""Datasets of a folder of meshes that are gone on with: whatever the folder is called, and what has changed in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from sdm import dataset
from sdm.cli import main
from sdm.dataset.layout import part_of
from sdm.dataset.manifest import read_manifest
from sdm.shapes import make_family

OUT = Path("d.zarr")


@pytest.fixture
def begun(tmp_path, monkeypatch) -> Path:
    """The folder `cochlea` with a closed and an open mesh, of which a dataset by a flood was begun, as of before."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "cochlea"
    folder.mkdir()
    ball = trimesh.creation.icosphere(1)
    ball.export(folder / "1.ply")
    ball.update_faces(np.arange(len(ball.faces)) > 10)
    ball.export(folder / "2.ply")

    def stop(done: int, total: int) -> None:
        if done:
            raise KeyboardInterrupt

    family = make_family("mesh-folder", str(folder), sign="flood")
    # Records of before do not say the sign of their source.
    own = {"source": {"folder": str(folder)}, "sign": "flood", "shard": 2, "device": "cpu"}
    with pytest.raises(KeyboardInterrupt):
        dataset.generate(family, family.grid(8), 6, OUT, progress=stop, **own)
    return folder


def test_an_old_one_by_a_flood_is_gone_on_with(begun, capsys):
    assert main(["generate", "-o", str(OUT), "--resume", "--device", "cpu"]) == 0
    assert capsys.readouterr().err == ""
    assert read_manifest(OUT)["recipe"]["sign"] == "flood"


def test_a_folder_that_is_called_like_a_family(begun, capsys):
    words = ["-o", str(OUT), "--resume", "--count", "6", "--resolution", "8", "--sign", "flood", "--device", "cpu"]
    assert main(["generate", "cochlea", *words]) == 2
    said = f"{part_of(OUT)} was begun from the folder {begun}, but the family cochlea was requested"
    assert capsys.readouterr().err == f"sdm: {said}: name the folder by its path (./cochlea)\n"
    assert main(["generate", "./cochlea", *words, "--shard", "2"]) == 0


def test_a_folder_whose_meshes_have_changed(begun, capsys):
    (begun / "2.ply").unlink()
    assert main(["generate", "-o", str(OUT), "--resume", "--device", "cpu"]) == 2
    assert f"the meshes of {begun} are not what {part_of(OUT)} was begun from" in capsys.readouterr().err
