"""Studies of the image's formation and of refusals: scenes, and records of what there is."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from sdm.bench.fit import campaign, formation, refusals
from sdm.bench.fit.case_rows import merged
from sdm.bench.fit.formation import CASES, scene
from sdm.bench.fit.pictures import draw_formation, draw_refusals
from sdm.bench.fit.tools import counted, run_cases
from sdm.core.grid import Grid
from sdm.fit import ExactBackend, random_state
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
    monkeypatch.setattr(formation, "run", lambda job: pytest.fail("a case was fitted again"))
    for name in CASES:
        for number, z in enumerate([0.0, 1.7 if name == "thick" else 1.0]):
            row = {"number": number, "z": [z] * 4 + [0.0] * 6, "z_before": [2.0] * 10, "deviations": [1.0] * 10}
            row |= {"trusted": True, "trusted_before": number == 0, "problems": [], "seconds": 1.0}
            (tmp_path / f"{name}-{number}.json").write_text(json.dumps(row))
    options = Namespace(
        folder=tmp_path, device="cpu", count=2, processes=1, first=0, budget_s=60.0, out=tmp_path / "out.json"
    )
    formation.formation(options)
    found = json.loads(options.out.read_text())["conditions"]
    assert found["thick"]["coverage_90_shape"] == 0.5
    assert found["matched"]["coverage_90_shape"] == 1.0
    assert found["matched"]["coverage_90_shape_before"] == 0.0
    assert found["matched"]["trusted_before"] == 1


def test_refusals_of_images_with_an_answer_are_counted():
    row = {"noise": 0.0, "trusted": True, "trusted_plain": False, "problems": [], "problems_plain": ["no"]}
    row |= {"z": [0.0] * 10, "whole": True, "cpu_seconds": 1.0}
    cut = {**row, "trusted": False, "whole": False}
    found = refusals.summary([row, {**row, "trusted": False, "noise": 200.0}, cut])
    assert (found["images"], found["with_an_answer"], found["refused"], found["refused_plain"]) == (3, 2, 1, 2)
    assert [r["refused"] for r in found["by_noise"]] == [0, 1]
    assert refusals.at_most(0, 300) == pytest.approx(0.01, abs=1e-4)
    assert refusals.at_most(3, 3) == 1
    scanners = [refusals.scanner_of(n) for n in range(40)]
    assert all(0.15 <= s.spacing <= 0.6 and 0.1 <= s.blur <= 0.4 for s in scanners)
    assert {s.noise for s in scanners} == set(refusals.NOISES)


def test_an_image_has_an_answer_where_the_true_shape_lies_in_it(truth: ExactBackend):
    state = random_state(truth, 2)
    world = state.to_world(truth.surface(state.theta)[0])
    low, high = world.min(0).values, world.max(0).values
    spacing = 0.25
    count = ((high - low) / spacing).ceil().int() + 1
    around = Grid(low.tolist(), (spacing,) * 3, count.tolist())
    cut = Grid((low + torch.tensor([0.0, 0.1, 0.0])).tolist(), (spacing,) * 3, count.tolist())
    assert refusals.lies_whole(truth, state, around)
    assert not refusals.lies_whole(truth, state, cut)


def test_cases_after_a_gap_do_not_count(tmp_path: Path):
    for number in (0, 1, 3):
        (tmp_path / f"{number}.json").write_text(json.dumps({"number": number}))
    assert [r["number"] for r in counted(tmp_path / f"{n}.json" for n in range(5))] == [0, 1]


@pytest.mark.parametrize("processes", [1, 2])
def test_every_job_is_done_once(tmp_path: Path, processes: int, monkeypatch: pytest.MonkeyPatch):
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "SDM_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    run_cases(Path.touch, [tmp_path / str(n) for n in range(5)], processes)
    assert len(list(tmp_path.iterdir())) == 5


def test_a_queue_that_stops_leaves_every_condition_with_the_same_share(tmp_path: Path):
    cases = campaign.queue(40, 50)
    assert len(set(cases)) == len(cases) == 40 * len(CASES) + 50
    for end in (100, 200):
        counts = [sum(case[:2] == ("formation", name) for case in cases[:end]) for name in CASES]
        assert max(counts) - min(counts) <= 1
        assert abs(sum(case[0] == "refusals" for case in cases[:end]) - end * 50 / len(cases)) < 3
    lines = tmp_path / "lines.jsonl"
    campaign._append(lines, {"study": "refusals", "condition": "", "number": 3, "record": {"number": 3}})
    campaign._append(lines, {"study": "formation", "condition": "blur", "number": 1, "record": {"number": 1}})
    with lines.open("a") as file:
        file.write('{"study": "ref')
    assert campaign.unpack(lines, tmp_path) == {("refusals", "", 3), ("formation", "blur", 1)}
    assert json.loads((tmp_path / "refusals" / "3.json").read_text()) == {"number": 3}
    assert (tmp_path / "formation" / "blur-1.json").is_file()


def test_a_summary_of_all_cases_is_that_of_their_parts():
    rng = np.random.default_rng(0)
    rows = []
    for number in range(60):
        z = (1.2 * rng.standard_normal(10) + 0.1).tolist()
        rows.append({"number": number, "z": z, "z_before": [2 * x for x in z], "deviations": [1.0] * 10})
        rows[-1] |= {"trusted": number % 9 != 0, "trusted_before": number % 7 != 0, "problems": ["no"], "seconds": 1.0}
    whole, one, two = (formation._summary(part) for part in (rows, rows[:23], rows[23:]))
    found = merged(one, two)
    assert found.pop("medians_of") == 37
    assert found.keys() == whole.keys()
    for key, value in whole.items():
        if key == "coverage_90":
            assert found[key] == pytest.approx(value, abs=1e-9)
        elif key in ("mean_of_z", "deviation_of_z"):
            assert found[key] == pytest.approx(value, abs=1.1e-3)
        elif isinstance(value, float):
            assert found[key] == pytest.approx(value, abs=1.1e-4), key
        elif key != "median_deviation":
            assert found[key] == value, key


def test_a_campaign_goes_on_from_its_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    old = {"number": 0, "z": [2.0] * 10, "z_before": [2.0] * 10, "deviations": [1.0] * 10, "seconds": 1.0}
    old |= {"trusted": True, "trusted_before": True, "problems": []}
    before = {"cases": 2, "conditions": {name: formation._summary([old, old]) for name in CASES}}
    image = {"number": 0, "noise": 0.0, "trusted": True, "trusted_plain": True, "z": [0.0] * 10, "whole": True}
    image |= {"cpu_seconds": 1.0, "commit": "a"}
    (tmp_path / "fit-formation.json").write_text(json.dumps({"before": before}))
    (tmp_path / "fit-refusals.json").write_text(json.dumps({"cases": [image]}))
    done = []

    def of_formation(job):
        name, number, options, _ = job
        done.append((name, number))
        row = {**old, "number": number, "z": [0.0] * 10, "commit": "b"}
        formation.path_of(name, number, options.folder).write_text(json.dumps(row))

    def of_refusals(job):
        number, options, _ = job
        done.append(("", number))
        refusals.path_of(number, options.folder).write_text(json.dumps({**image, "number": number, "commit": "b"}))

    monkeypatch.setattr(formation, "run", of_formation)
    monkeypatch.setattr(refusals, "run", of_refusals)
    options = Namespace(
        folder=tmp_path / "cases", lines=tmp_path / "lines.jsonl", out=tmp_path / "fit-campaign.json", device="cpu",
        count=4, images=3, first=0, first_image=0, processes=1, budget_s=60.0,
    )  # fmt: skip
    campaign.campaign(options)
    assert sorted(done) == sorted([("", 1), ("", 2), *((name, number) for name in CASES for number in (2, 3))])
    made = json.loads((tmp_path / "fit-formation.json").read_text())
    assert made["rows"] == {"file": "fit-formation.jsonl", "from": 2, "commits": {"b": 2 * len(CASES)}}
    assert made["conditions"]["thick"]["cases"] == 4
    assert made["conditions"]["thick"]["coverage_90_shape"] == 0.5
    assert json.loads((tmp_path / "fit-refusals.json").read_text())["commits"] == {"a": 1, "b": 2}
    # Anywhere else, from the records alone.
    done.clear()
    options.folder, options.lines, options.count = tmp_path / "others", tmp_path / "none.jsonl", 5
    campaign.campaign(options)
    assert sorted(done) == [(name, 4) for name in sorted(CASES)]
    assert json.loads((tmp_path / "fit-formation.json").read_text())["conditions"]["thick"]["cases"] == 5


def test_the_picture_has_what_the_records_say():
    figure = Figure()
    one, two = figure.subplots(1, 2)
    found = {"coverage_90_shape": 0.9, "coverage_90_shape_before": 0.5, "standard_error_shape": 0.01, "cases": 7}
    draw_formation({"conditions": dict.fromkeys(CASES, found)}, one)
    assert one.get_title(loc="left") == "7 shapes, each imaged in six ways"
    assert [list(line.get_ydata()) for line in one.get_lines() if line.get_label() == "not estimated"] == [[0.5] * 6]
    rows = [{"noise_HU": 5.0, "coverage_90_shape": 0.875, "images": 2}]
    cases = [{"noise": 5.0, "trusted": True, "z": [z] * 4 + [9.0] * 6} for z in (0.0, 2.0)]
    draw_refusals({"by_noise": rows, "cases": cases, "images": 2, "refused": 1}, two)
    assert two.get_title(loc="left").endswith("1 refused")
    assert two.get_lines()[1].get_ydata() == pytest.approx([0.875])
