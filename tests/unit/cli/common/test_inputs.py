"""No command writes over what it reads, whatever the file is called."""

from __future__ import annotations

import os
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.cli import main
from sdm.cli.common.inputs import refuse_inputs
from sdm.errors import FormatError
from tests.helpers.segmentation_cases import write_nnunet

GRID = sdm.Grid((-1.2, -1.2, -1.2), (0.4, 0.4, 0.4), (7, 7, 7))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with an image ct.nii.gz, a label t.nii.gz and a mesh ball.ply."""
    monkeypatch.chdir(tmp_path)
    sdm.SDM(torch.rand(GRID.shape), GRID).save("ct.nii.gz")
    for name in ("a.nii.gz", "t.nii.gz"):
        nib.save(nib.Nifti1Image(np.eye(5, dtype=np.uint8)[None].repeat(5, 0), np.eye(4)), name)
    trimesh.creation.icosphere(1).export("ball.ply")
    return tmp_path


def run(words: str) -> int:
    return main(words.split())


def refused(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Refused in one sentence, and every file is what it was."""
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    assert run(words) == 2
    assert capsys.readouterr().err.endswith(" is an input too, and would be lost: choose another name for the output\n")
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before


def test_a_file_under_another_name_is_the_same(place: Path) -> None:
    (place / "folder").mkdir()
    os.symlink(place / "ct.nii.gz", "linked.nii.gz")
    for name in (place / "ct.nii.gz", Path("folder/../ct.nii.gz"), Path("linked.nii.gz")):
        with pytest.raises(FormatError, match="is an input too"):
            refuse_inputs([None, name], [None, Path("none.nii.gz"), Path("ct.nii.gz")])
    refuse_inputs([None, Path("none.nii.gz"), Path("a.nii.gz")], [None, Path("none.nii.gz"), Path("ct.nii.gz")])


@pytest.mark.parametrize(
    "words",
    [
        "fit ct.nii.gz -o ct.nii.gz",
        "fit ct.nii.gz -o fit.json --mesh ct.nii.gz",
        "compute ball.ply --grid-like ct.nii.gz -o ct.nii.gz",
        "compute ball.ply --grid-like ct.nii.gz -o ./ct.nii.gz",
        "compute ball.ply --grid-like ct.nii.gz -o ct.nii.gz --resume",
        "evaluate a.nii.gz t.nii.gz --json t.nii.gz",
        "evaluate a.nii.gz t.nii.gz --json a.nii.gz",
        "evaluate . . --json t.nii.gz",
        "encode ball.ply -m model.npz -o model.npz",
        "decode code.npz -m cochlea -o code.npz",
        "decode code.npz -m cochlea --to other.png -o other.png",
        "predict --a 3.7 --alpha 0.45 --b 0.146 --phi -0.6 --weights model.npz -o model.npz",
    ],
)
def test_an_output_that_is_an_input(place: Path, capsys: pytest.CaptureFixture[str], words: str) -> None:
    for name in ("code.npz", "other.png", "model.npz"):
        (place / name).write_text("mine")
    refused(words, capsys)


def test_an_older_output_is_replaced_as_before(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(2):
        assert run("compute ball.ply --grid-like ct.nii.gz --device cpu -o ball.nii.gz") == 0
    capsys.readouterr()
    trimesh.creation.icosphere(2).export("other.ply")
    several = "compute ball.ply other.ply -o . --grid-like ball.nii.gz --device cpu"
    refused(several, capsys)
    # The map that gives the grid is finished, and so it is skipped.
    assert run(f"{several} --resume") == 0
    assert "ball.nii.gz is there already" in capsys.readouterr().out
    for _ in range(2):
        assert run("evaluate a.nii.gz t.nii.gz --json scores.json") == 0


def test_images_and_true_labels_are_not_replaced_by_labels(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_nnunet(place / "data")
    quick = "--patch 16 16 16 --filters 2 --network unet --batch-size 1 --steps 1 --device cpu"
    assert run(f"train segmentation --data data --out net {quick}") == 0
    capsys.readouterr()
    (place / "im").mkdir()
    (place / "data" / "imagesTr" / "case0_0000.nii.gz").rename("im/c0.nii.gz")
    (place / "data" / "imagesTr" / "case1_0000.nii.gz").rename("im/c1_sdm.nii.gz")
    model = "--model net/model.pt --device cpu --out"
    refused(f"segment im {model} im", capsys)
    refused(f"segment im/c1_sdm.nii.gz {model} im/../im", capsys)
    refused(f"segment data {model} data/labelsTr", capsys)
    refused(f"segment data/imagesTs {model} data/labelsTs", capsys)
    refused(f"segment data/imagesTs/case3_0000.nii.gz {model} data/labelsTs", capsys)
    assert run(f"segment im {model} out") == 0
    assert run(f"segment im {model} out") == 0
