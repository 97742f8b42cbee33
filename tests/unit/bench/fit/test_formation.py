"""Studies of the image's formation and of refusals: scenes, and records of what there is."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path

import pytest
import torch

from sdm.bench.fit import formation, refusals
from sdm.bench.fit.formation import CASES, scene
from sdm.fit import ExactBackend
from sdm.fit.model.pose import vector_from_rotation
from sdm.shapes import Cochlea


@pytest.fixture(scope="module")
def truth() -> ExactBackend:
    return ExactBackend(Cochlea(500), "cpu")


def test_scenes_are_what_they_say(truth: ExactBackend, monkeypatch: pytest.MonkeyPatch):
    grids = []

    def no_image(backend, state, scanner, *, seed, grid=None):
        grids.append((scanner, grid))
        return formation.Image(torch.zeros(4, 4, 4), grid)

    monkeypatch.setattr(formation, "simulate", no_image)
    states = {name: scene(truth, case, 3)[0] for name, case in CASES.items()}
    by_name = dict(zip(CASES, grids, strict=True))
    assert by_name["blur"][0].blur == 0.3
    assert by_name["thick"][1].spacing == pytest.approx((0.3, 0.3, 0.6))
    assert torch.equal(states["blur"].rotation, states["matched"].rotation)
    angle = float(vector_from_rotation(states["turned"].rotation).norm())
    assert 0 < angle <= 1.5708
    assert torch.equal(states["turned"].theta, states["matched"].theta)


def test_a_study_is_summed_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(formation, "_run", lambda job: pytest.fail("a case was fitted again"))
    for name in CASES:
        for number, z in enumerate([0.0, 1.7 if name == "thick" else 1.0]):
            row = {"number": number, "z": [z] * 4 + [0.0] * 6, "z_before": [2.0] * 10, "deviations": [1.0] * 10}
            row |= {"trusted": True, "trusted_before": number == 0, "problems": [], "seconds": 1.0}
            (tmp_path / f"{name}-{number}.json").write_text(json.dumps(row))
    options = Namespace(folder=tmp_path, device="cpu", count=2, workers=1, budget_s=60.0, out=tmp_path / "out.json")
    formation.formation(options)
    found = json.loads(options.out.read_text())["conditions"]
    assert found["thick"]["coverage_90_shape"] == 0.5
    assert found["matched"]["coverage_90_shape"] == 1.0
    assert found["matched"]["coverage_90_shape_before"] == 0.0
    assert found["matched"]["trusted_before"] == 1


def test_refusals_of_images_with_an_answer_are_counted():
    row = {"noise": 0.0, "trusted": True, "trusted_plain": False, "problems": [], "problems_plain": ["no"]}
    row["z"] = [0.0] * 10
    cut = {**row, "trusted": False, "problems_plain": ["the shape reaches the image's border: take more"]}
    found = refusals.summary([row, {**row, "trusted": False, "noise": 200.0}, cut])
    assert (found["images"], found["with_an_answer"], found["refused"], found["refused_plain"]) == (3, 2, 1, 2)
    assert [r["refused"] for r in found["by_noise"]] == [0, 1]
    scanners = [refusals.scanner_of(n) for n in range(40)]
    assert all(0.15 <= s.spacing <= 0.6 and 0.1 <= s.blur <= 0.4 for s in scanners)
    assert {s.noise for s in scanners} == set(refusals.NOISES)
