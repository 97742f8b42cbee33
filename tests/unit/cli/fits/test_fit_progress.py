"""Notice of images that are much larger than the shape in them."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import sdm
from sdm.cli.common import progress as progress_module
from sdm.cli.fits.fit_progress import FitProgress, size_notice
from sdm.fit import FitOptions


def volume(size: int, spacing: float = 0.3) -> sdm.SDM:
    values = torch.zeros(size, size, size)
    values[5:9, 4:8, 6:20] = 1
    return sdm.SDM(values, sdm.Grid((0, 0, 0), (spacing,) * 3, (size,) * 3))


def test_a_cropped_image_is_no_matter():
    assert size_notice(volume(40), 0.15) is None


def test_an_uncropped_label_volume_says_what_to_crop():
    said = size_notice(volume(100), 0.15)
    assert said == (
        "100 x 100 x 100 voxels of 0.3 are 8 million sample points, which take long and much memory: crop it to voxels "
        "5 to 8, 4 to 7, 6 to 19, which alone differ from 0, and a few voxels around"
    )


@pytest.mark.parametrize("values", [torch.rand(100, 100, 100), torch.zeros(100, 100, 100)], ids=["noise", "empty"])
def test_where_nothing_tells_the_shape(values):
    said = size_notice(volume(100).with_values(values), 0.15)
    assert said is not None
    assert said.endswith("crop it to the shape and a few voxels around")


def test_how_long_it_takes_is_said_once_steps_are_timed(capsys):
    with FitProgress(Path("scan.nii.gz"), volume(100), FitOptions()) as progress:
        # Of a coarse image.
        progress("start", 1, None)
        progress("start", 2, None)
        (size,) = capsys.readouterr().err.splitlines()
        assert size.startswith("sdm: scan.nii.gz: 100 x 100 x 100 voxels")
        for stage in ("fine", "finish"):
            for step in (1, 2, 3):
                progress(stage, step, None)
    (pace,) = capsys.readouterr().err.splitlines()
    assert "a step takes about" in pace


def test_steps_are_lines_in_a_log(capsys, monkeypatch):
    monkeypatch.setattr(progress_module, "LOG_INTERVAL", 0.0)
    with FitProgress(Path("scan.nii.gz"), volume(20), FitOptions()) as progress:
        progress("fine", 1, None)
        progress("fine", 2, None)
    assert [line.rpartition(",")[0] for line in capsys.readouterr().err.splitlines()] == [
        "sdm: fine, step 1",
        "sdm: fine, step 2",
    ]
