"""Files of models and codes: whole, known, and of this version."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from sdm.deepsdf import DeepSDF, ShapeCode, load_code, save_code
from sdm.deepsdf.samples import UnitSphere
from sdm.deepsdf.train import checkpoint
from sdm.errors import FormatError


def test_a_model_of_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "VERSION", 99)
    checkpoint.write({}, tmp_path / "model.pt")
    monkeypatch.undo()
    with pytest.raises(FormatError, match="a DeepSDF model of version 99, and this program reads version 1"):
        DeepSDF.load(tmp_path / "model.pt", "cpu")


def test_what_is_no_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="is not there; train a model first"):
        DeepSDF.load(tmp_path / "none.pt", "cpu")
    path = tmp_path / "some.pt"
    path.write_bytes(b"not a model")
    with pytest.raises(FormatError, match="is no DeepSDF model, or it is damaged"):
        DeepSDF.load(path, "cpu")
    torch.save({"weights": torch.zeros(3)}, path)
    with pytest.raises(FormatError, match="give a file that sdm train deepsdf wrote"):
        DeepSDF.load(path, "cpu")
    checkpoint.write({"state": torch.zeros(1000)}, path)
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(FormatError, match="is no DeepSDF model, or it is damaged"):
        DeepSDF.load(path, "cpu")


def test_what_an_optimizer_needs_is_no_model(tmp_path: Path) -> None:
    checkpoint.write({"state": {}, "step": 1}, tmp_path / checkpoint.OPTIMIZER)
    with pytest.raises(FormatError, match=r"optimizer; give the model\.pt beside it"):
        DeepSDF.load(tmp_path / checkpoint.OPTIMIZER, "cpu")


def test_a_file_that_would_run_code_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "evil.pt"
    torch.save({"kind": checkpoint.KIND, "version": checkpoint.VERSION, "run": print}, path)
    with pytest.raises(FormatError, match="is no DeepSDF model, or it is damaged"):
        DeepSDF.load(path, "cpu")


def test_a_checkpoint_is_replaced_as_one(tmp_path: Path) -> None:
    folder = tmp_path / "checkpoint"
    for step in (1, 2):
        checkpoint.write_both({"step": step}, {"step": step}, folder)
    assert [torch.load(folder / n)["step"] for n in (checkpoint.MODEL, checkpoint.OPTIMIZER)] == [2, 2]
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint"]


def test_codes_come_back(tmp_path: Path) -> None:
    shape = ShapeCode(torch.randn(7), UnitSphere((1.0, 2.5, -3.0), 0.1))
    save_code(shape, tmp_path / "it.npz")
    again = load_code(tmp_path / "it.npz")
    assert torch.equal(again.code, shape.code)
    assert again.sphere == shape.sphere


def test_bad_code_files_are_said(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="is not there; make it with sdm encode"):
        load_code(tmp_path / "none.npz")
    path = tmp_path / "bad.npz"
    path.write_bytes(b"PK\x03\x04 nonsense")
    with pytest.raises(FormatError, match="is no code of a shape"):
        load_code(path)
    np.savez(path, other=1)
    with pytest.raises(FormatError, match="is no code of a shape"):
        load_code(path)
    np.savez(path, version=7, code=np.zeros(3), sphere=np.ones(4))
    with pytest.raises(FormatError, match="is a code of version 7, and this program reads version 1"):
        load_code(path)
    for code, sphere in (
        (np.zeros(3), np.ones(2)),
        (np.zeros(3), np.array(1.0)),
        (np.zeros(3), np.array(["a", "b", "c", "d"])),
        (np.array([b"abc"]), np.ones(4)),
        (np.zeros((3, 3)), np.ones(4)),
    ):
        np.savez(path, version=1, code=code, sphere=sphere)
        with pytest.raises(FormatError, match="it needs a code of numbers, and a centre with a radius"):
            load_code(path)


def test_a_model_of_a_newer_program_is_refused(tmp_path: Path) -> None:
    content = checkpoint.read_model(Path("cochlea"))
    checkpoint.write({**content, "settings": {**content["settings"], "novel": 1}}, tmp_path / "model.pt")
    with pytest.raises(FormatError, match=r"model\.pt has settings that this program does not know"):
        DeepSDF.load(tmp_path / "model.pt", "cpu")
