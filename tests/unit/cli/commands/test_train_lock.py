"""Of two trainings that would write to the same files the second is refused before it reads a checkpoint."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from sdm.cli import main
from sdm.io.files.lock import alone
from tests.helpers.segmentation_cases import write_nnunet

UNET = ["--patch", "16", "16", "16", "--filters", "4", "--network", "unet", "--steps", "2"]


def segmentation(folder: Path) -> tuple[list[str], Path]:
    write_nnunet(folder / "data")
    return ["segmentation", "--data", str(folder / "data"), "--out", str(folder / "net"), *UNET], folder / "net"


def deepsdf(folder: Path) -> tuple[list[str], Path]:
    (folder / "meshes").mkdir()
    for size in (1.0, 2.0):
        trimesh.creation.box((size, 1, 1)).export(folder / "meshes" / f"{size}.stl")
    return ["deepsdf", str(folder / "meshes"), "--out", str(folder / "net"), "--epochs", "1"], folder / "net"


def sdmnn(folder: Path) -> tuple[list[str], Path]:
    words = ["sdmnn", "--out", str(folder / "net"), "--model", "sdmnn", "--recipe", "online", "--steps", "1"]
    # Others may train another model into the same folder.
    return words, folder / "net" / "sdmnn-online"


@pytest.mark.parametrize("kind", [segmentation, deepsdf, sdmnn])
def test_one_at_a_time(tmp_path, capsys, kind):
    words, folder = kind(tmp_path)
    folder.mkdir(parents=True)
    with alone(folder):
        assert main(["train", *words, "--device", "cpu"]) == 2
    assert f"{folder} is being written by another process: wait for it, or end it" in capsys.readouterr().err
    assert not list(folder.iterdir())
