"""`sdm evaluate` of labels with several classes: scores of each class, and their mean."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import nibabel as nib
import numpy as np
import pytest

from sdm.cli import main
from sdm.metrics import evaluate_segmentation
from tests.helpers.segmentation_cases import write_hdf5

SPACING = (0.8, 0.8, 1.5)
AFFINE = np.diag([*SPACING, 1.0])
EVALUATE = ["evaluate", "p", "t", "--device", "cpu", "--json", "scores.json"]


def _truth() -> np.ndarray:
    label = np.zeros((20, 18, 14), np.int16)
    # One of them at the volume's border.
    label[0:6, 3:9, 2:8], label[8:15, 4:12, 3:11], label[16:19, 1:4, 1:4] = 1, 2, 300
    return label


def _prediction() -> np.ndarray:
    label = np.roll(_truth(), (1, 1, 0), (0, 1, 2))
    label[label == 1] = np.where(np.arange((label == 1).sum()) % 5, 1, 2)
    return label


def _write(folder: str, name: str, label: np.ndarray) -> None:
    Path(folder).mkdir(exist_ok=True)
    nib.save(nib.Nifti1Image(label, AFFINE), Path(folder) / f"{name}.nii.gz")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_each_class_is_scored_as_a_mask_of_its_own(capsys):
    _write("p", "a", _prediction())
    _write("t", "a", _truth())
    assert main(EVALUATE) == 0
    said = capsys.readouterr()
    assert not said.err
    found = json.loads(Path("scores.json").read_text())["a"]
    wanted = {
        str(value): asdict(evaluate_segmentation(_prediction() == value, _truth() == value, SPACING))
        for value in (1, 2, 300)
    }
    assert found.pop("classes") == wanted
    assert 0 < wanted["1"]["dice"] < wanted["2"]["dice"] < 1
    for column, value in found.items():
        assert value == pytest.approx(np.mean([case[column] for case in wanted.values()]))
    rows = [line.split(" | ")[:2] for line in said.out.splitlines()[2:]]
    assert [row[0] for row in rows] == ["| class 1", "| class 2", "| class 300", "| mean of 3 classes"]
    assert rows[0][1] == f"{100 * wanted['1']['dice']:.2f}"
    assert rows[3][1].startswith(f"{100 * found['dice']:.2f} (")


def test_a_class_of_one_label_alone_has_failed(capsys):
    truth = _truth()
    _write("p", "a", np.where(truth == 300, 4, truth))
    _write("t", "a", truth)
    assert main(EVALUATE) == 0
    said = capsys.readouterr().out
    assert "failed, for the prediction alone has it: class 4\n" in said
    assert "failed, for the truth alone has it: class 300\n" in said
    assert "| class 300 | 0.00 | 0.00 | 0.00 | - [1 failed] |" in said
    assert "| mean of 4 classes | 50.00 " in said
    case = json.loads(Path("scores.json").read_text(), parse_constant=pytest.fail)["a"]
    assert (case["dice"], case["hausdorff95_mm"], case["failed"]) == (0.5, 0, True)
    for value in ("4", "300"):
        missed = case["classes"][value]
        assert (missed["dice"], missed["hausdorff95_mm"], missed["failed"]) == (0, None, True)


def test_in_a_folder_one_case_of_several_classes_makes_all_such(capsys):
    """Also those before it, whose classes would be merged alone; what both labels lack is in no mean."""
    truth = _truth()
    one, two = np.where(truth == 1, 1, 0), np.where(truth == 300, 0, truth)
    for name, prediction, true in (
        ("a", one, one),
        ("b", one, two),
        ("c", _prediction(), truth),
        ("d", 0 * truth, 0 * truth),
    ):
        _write("p", name, prediction.astype(np.int16))
        _write("t", name, true.astype(np.int16))
    assert main(EVALUATE) == 0
    said = capsys.readouterr()
    assert not said.err
    cases = json.loads(Path("scores.json").read_text())
    assert {name: list(case["classes"]) for name, case in cases.items()} == {
        "a": ["1"],
        "b": ["1", "2"],
        "c": ["1", "2", "300"],
        "d": [],
    }
    assert cases["b"]["dice"] == 0.5
    assert "failed, for the truth alone has it: b, class 2\n" in said.out
    assert "in no mean, for both labels are empty: d\n" in said.out
    dice = {name: {v: s["dice"] for v, s in case["classes"].items()} for name, case in cases.items()}
    means = [np.mean([of["1"] for of in dice.values() if "1" in of]), (0 + dice["c"]["2"]) / 2, dice["c"]["300"]]
    for start in (
        f"| class 1, mean of 3 | {100 * means[0]:.2f} (",
        f"| class 2, mean of 2 | {100 * means[1]:.2f} (",
        f"| class 300, mean of 1 | {100 * means[2]:.2f} |",
        f"| mean of 3 classes | {100 * np.mean(means):.2f} (",
        "| c, class 300 |",
    ):
        assert f"\n{start}" in said.out


def test_classes_of_hdf5(capsys):
    write_hdf5(Path("t/a.h5"), np.zeros(_truth().shape, np.float32), _truth(), spacing=SPACING)
    _write("p", "a", _truth())
    assert main(EVALUATE) == 0
    assert list(json.loads(Path("scores.json").read_text())["a"]["classes"]) == ["1", "2", "300"]
    assert "| mean of 3 classes | 100.00 (0.00) |" in capsys.readouterr().out


def test_masks_are_foreground_whatever_their_number(capsys):
    mask = (_truth() > 0).astype(np.int16)
    _write("p", "a", 255 * mask)
    _write("t", "a", mask)
    assert main(EVALUATE) == 0
    assert "\n| a | 100.00 | 100.00 | 100.00 | 0.00 | 0.00 | 0.00 |\n" in capsys.readouterr().out
    assert json.loads(Path("scores.json").read_text())["a"] == asdict(evaluate_segmentation(mask, mask, SPACING))


def test_an_image_of_whole_numbers_is_no_label(capsys):
    _write("p", "a", np.arange(20 * 18 * 14, dtype=np.int16).reshape(20, 18, 14))
    _write("t", "a", _truth())
    assert main(EVALUATE) == 2
    assert "a.nii.gz has 5,039 different values, so it is no label" in capsys.readouterr().err
