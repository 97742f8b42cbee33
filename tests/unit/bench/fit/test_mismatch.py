"""Images under mismatch: what each condition changes, and a record of a short study."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
import torch

from sdm import Grid
from sdm.bench.fit import mismatch
from sdm.bench.fit.mismatch import CLINICAL, CONDITIONS, correlated, heavy_tailed, image_of, white
from sdm.fit import Image

SHAPE = (24, 20, 22)


@pytest.mark.parametrize(
    ("noise", "neighbours", "kurtosis"), [(white, 0, 3), (correlated, 0.5, 3), (heavy_tailed, 0, 9)]
)
def test_noise_is_of_unit_deviation(noise, neighbours, kurtosis):
    values = noise(np.random.default_rng(1), (40, 40, 40))
    assert abs(values.std() - 1) < 0.05
    assert abs(np.corrcoef(values[1:].ravel(), values[:-1].ravel())[0, 1] - neighbours) < 0.1
    assert (values**4).mean() > 0.9 * kurtosis


def test_a_condition_changes_what_it_says():
    clean = Image(torch.full(SHAPE, 1000.0), Grid([0.0] * 3, [0.3] * 3, SHAPE))
    images = {name: image_of(clean, condition, 5).values for name, condition in CONDITIONS.items()}
    assert torch.equal(images["matched"], image_of(clean, CONDITIONS["matched"], 5).values)
    assert torch.equal(images["matched"], images["labels"])
    assert not torch.equal(images["matched"], images["correlated"])
    shade = (images["shading"] - images["matched"]).numpy()
    np.testing.assert_allclose(shade[[0, -1]].mean((1, 2)), [-100, 100], atol=0.01)
    assert abs(float(images["matched"].std()) - CLINICAL.noise) < 10
    assert not torch.equal(images["matched"], image_of(clean, CONDITIONS["matched"], 6).values)


def test_a_study_is_resumed_and_summed_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(mismatch, "_run", lambda job: pytest.fail("a case was fitted again"))
    for name in CONDITIONS:
        for number, z in enumerate([0.0, 1.7 if name == "shading" else 1.0]):
            row = {"number": number, "z": [z] * 4 + [0.0] * 6, "deviations": [1.0] * 10, "trusted": True}
            (tmp_path / f"{name}-{number}.json").write_text(json.dumps({**row, "problems": [], "seconds": 1.0}))
    options = Namespace(
        folder=tmp_path, device="cpu", count=2, processes=1, first=0, budget_s=60.0, out=tmp_path / "out.json"
    )
    mismatch.mismatch(options)
    found = json.loads(options.out.read_text())["conditions"]
    assert found["shading"]["coverage_90_shape"] == 0.5
    assert found["shading"]["standard_error_shape"] == 0.5
    assert found["matched"]["coverage_90_shape"] == 1.0
