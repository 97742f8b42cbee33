"""The liver part of Ma's study: its loader, and that its command trains on what that writes."""

from __future__ import annotations

import gzip
import json
import sys
from typing import Any

import nibabel
import numpy as np
import pytest

from sdm.bench.segmentation import liver, ma
from sdm.errors import FormatError
from sdm.segmentation import read_cases

nib: Any = nibabel
SHAPE = (40, 36, 24)
HEAD = (
    "#INRIMAGE-4#{{\nXDIM={}\nYDIM={}\nZDIM={}\nVDIM=1\nTYPE=unsigned fixed\nPIXSIZE=8 bits\nVX=0.5\nVY=0.5\nVZ=1.5\n"
)


def labelled() -> np.ndarray:
    """A ball of liver with a ball of the label that is to be found in it."""
    middle = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), -1) - np.array([18, 18, 12])
    reach = np.linalg.norm(middle, axis=-1)
    return np.where(reach < 6, liver.SMOKE_LABEL, np.where(reach < 10, 255, 0)).astype(np.uint8)


@pytest.fixture
def inr(tmp_path):
    path = tmp_path / "liver.inr.gz"
    head = HEAD.format(*SHAPE).encode().ljust(liver.HEADER - 4, b"\n") + b"##}\n"
    path.write_bytes(gzip.compress(head + labelled().tobytes(order="F")))
    return path


def test_an_inrimage_is_read(inr):
    values, spacing = liver.read_inr(inr)
    np.testing.assert_array_equal(values, labelled())
    assert spacing.tolist() == [0.5, 0.5, 1.5]


def test_a_cut_or_foreign_inrimage_is_refused(inr, tmp_path):
    data = gzip.decompress(inr.read_bytes())
    for content, said in ((data[:-1], "cut off"), (b"x" + data, "no INRIMAGE")):
        (tmp_path / "other.inr").write_bytes(content)
        with pytest.raises(FormatError, match=said):
            liver.read_inr(tmp_path / "other.inr")


def test_lits_is_cropped_to_the_liver_and_its_tumours(tmp_path):
    source, out = tmp_path / "Task03_Liver", tmp_path / "out"
    labels = np.zeros((70, 66, 64), np.uint8)
    labels[30:40, 28:36, 30:40] = 1
    affine = np.diag([-0.7, 0.7, 2.0, 1.0])
    for number, tumour in enumerate((True, False, True)):
        labels[33:36, 30:33, 33:36] = liver.TUMOUR if tumour else 1
        for folder, array in (("imagesTr", np.full(labels.shape, 1000, np.int16)), ("labelsTr", labels)):
            (source / folder).mkdir(parents=True, exist_ok=True)
            nib.save(nib.Nifti1Image(array, affine), source / folder / f"liver_{number}.nii.gz")
    assert liver.prepare(source, out) == 2
    (train,), (validate,) = read_cases(out, "train"), read_cases(out, "val")
    assert (train.name, validate.name) == ("liver_002", "liver_000")
    assert train.label is not None
    assert int(train.label.sum()) == 27
    assert tuple(train.label.shape[-3:]) == (50, 48, 50)
    image = nib.load(out / "imagesTr" / "liver_002_0000.nii.gz")
    assert image.affine[:3, 3].tolist() == pytest.approx([-7.0, 5.6, 20.0])
    assert float(np.asarray(image.dataobj).max()) == liver.WINDOW[1]
    with pytest.raises(FormatError, match="no cases with tumours"):
        liver.prepare(tmp_path / "nothing", out)


@pytest.mark.slow
def test_the_studys_command_runs_on_the_smoke_case(inr, tmp_path, monkeypatch):
    liver.main(["smoke", str(inr), "--out", str(tmp_path / "liver")])
    logs = tmp_path / "liver.jsonl"
    small = ["--seeds=0", "--steps=2", "--batch=1", "--filters=2", "--augment=none", "--patch", "32", "32", "16"]
    places = ["--data", str(tmp_path / "liver"), "--logs", str(logs), "--work", str(tmp_path / "work")]
    monkeypatch.setattr(sys, "argv", ["ma", "run", "--methods", "head-sdf-l1", *small, *places])
    ma.main()
    (log,) = [json.loads(line) for line in logs.read_text().splitlines()]
    assert log["job"]["settings"]["method"] == "head-sdf-l1"
    assert "smoke_1" in json.dumps(log)
