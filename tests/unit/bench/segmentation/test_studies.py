"""The studies' machinery: jobs go on where they were, tables come from logs, shapes and enlargements are right."""

from __future__ import annotations

import argparse
import math
import multiprocessing
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from sdm.bench.segmentation import juhl, ma, plots, report
from sdm.bench.segmentation.gpu_jobs import claimed, run_jobs
from sdm.bench.segmentation.juhl_shapes import ShapeBatches, _at_coarse, shapes
from sdm.bench.segmentation.log_file import LogFile, log_file
from sdm.bench.segmentation.pack import pack, unpack
from sdm.bench.segmentation.seeds import repeats_table, spread_of
from sdm.bench.segmentation.time_budget import fitted_steps
from sdm.bench.segmentation.trials import differs
from sdm.errors import FormatError
from sdm.segmentation import MA_ROWS, METHODS
from tests.helpers.segmentation_cases import volume, write_hdf5

# Done by the jobs of this test, by name.
calls: list[str] = []


def work(job, device, unfinished, kept, deadline):
    calls.append(job["name"])
    if job["name"] == "bad":
        raise ValueError("no")
    return None if job["name"] == "slow" else {"value": math.inf, "list": [1.23456789]}


def run(tmp_path: Path, *names: str, budget_s: float = 60.0) -> list[str]:
    calls.clear()
    logs = LogFile(tmp_path / "logs.jsonl")
    run_jobs([{"name": n} for n in names], work, logs, tmp_path / "work", budget_s=budget_s, on=["cpu"])
    return list(calls)


def test_jobs_that_are_done_are_not_done_again(tmp_path, capsys):
    assert run(tmp_path, "a", "bad", "slow", "b") == ["a", "bad", "slow", "b"]
    assert "bad failed on cpu" in capsys.readouterr().out
    assert [log["job"]["name"] for log in LogFile(tmp_path / "logs.jsonl").trainings()] == ["a", "b"]
    assert run(tmp_path, "a", "bad", "slow", "b", "c") == ["bad", "slow", "c"]
    log = LogFile(tmp_path / "logs.jsonl").trainings()[0]
    assert log["value"] == math.inf
    assert log["list"] == [1.2346]


def add_logs(file: LogFile, first: int) -> None:
    for number in range(first, first + 20):
        file.put({"job": {"name": f"{number:02}"}, "value": number / 3})


def test_processes_write_one_log_file_together(tmp_path):
    file = LogFile(tmp_path / "logs.jsonl", "one")
    file.put({"job": {"name": "20"}, "value": "replaced"})
    LogFile(file.path).put({"job": {"name": "20"}, "value": math.nan})
    context = multiprocessing.get_context("fork")
    processes = [context.Process(target=add_logs, args=(file, first)) for first in (0, 20)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [log["job"]["name"] for log in file.trainings()] == [f"{number:02}" for number in range(40)]
    assert file.trainings()[20] == {"job": {"name": "20"}, "value": 6.6667}
    (other,) = LogFile(file.path).trainings()
    assert math.isnan(other["value"])
    assert list(LogFile(file.path).trials()) == ["one"]
    file.remove("20")
    assert len(file.trainings()) == 39
    assert LogFile(file.path).names() == {"20"}
    assert list(tmp_path.iterdir()) == [file.path]


def test_a_damaged_line_is_named(tmp_path):
    (tmp_path / "logs.jsonl").write_text('{"job": {"name": "a"}}\n{"job": {"na\n')
    with pytest.raises(FormatError, match=r"logs\.jsonl, line 2, is not JSON"):
        LogFile(tmp_path / "logs.jsonl").trainings()


def test_names_of_log_files():
    assert log_file("runs/a.jsonl") == LogFile(Path("runs/a.jsonl"))
    assert log_file("runs/a.jsonl/b") == LogFile(Path("runs/a.jsonl"), "b")
    assert str(log_file("runs/a.jsonl/b")) == "runs/a.jsonl/b"
    with pytest.raises(argparse.ArgumentTypeError, match="runs/a is no log file: give FILE"):
        log_file("runs/a")


def both(job):
    """Whichever of two jobs ends first: a process may find the other's work done before its log is written."""
    return {"name": "both"} if job["name"] in ("a", "b") else None


def test_what_follows_several_jobs_is_done_once(tmp_path):
    listed = [{"name": "a"}, {"name": "b"}]
    logs, unfinished = LogFile(tmp_path / "logs.jsonl"), tmp_path / "work"
    calls.clear()
    run_jobs(listed, work, logs, unfinished, budget_s=60.0, on=["cpu"], follow=both)
    assert calls == ["a", "both", "b"]
    assert not claimed(unfinished, {"name": "both"})
    # A run that was cut short leaves its claims behind; the next begins afresh.
    logs.path.unlink()
    run_jobs(listed, work, logs, unfinished, budget_s=60.0, on=["cpu"], follow=both)
    assert calls == ["a", "both", "b"] * 2


def test_no_job_begins_after_the_budget(tmp_path):
    assert run(tmp_path, "a", budget_s=-1.0) == []


def test_steps_fit_the_budget():
    steps = fitted_steps(lambda n: 0.1 * n, 8, 4, 100.0, weight=1.0, overhead_s=2.5)
    assert steps == 400


def test_rows_of_the_study_of_left_atria():
    options = ma.parser().parse_args(["run"])
    jobs = ma.jobs(options)
    assert [j["settings"]["method"] for j in jobs[:16]] == list(MA_ROWS)
    assert {"pwr", "hausdorff-foreground"} <= {j["settings"]["method"] for j in jobs}
    assert len({j["name"] for j in jobs}) == len(jobs) == 18 * 3
    protocols = [{k: v for k, v in j["settings"].items() if k not in ("method", "seed")} for j in jobs]
    assert all(p == protocols[0] for p in protocols)


@pytest.mark.parametrize(("method", "more"), [("baseline", []), ("pwr", ["--position", "--mirrors="])])
def test_a_study_of_left_atria_in_small(tmp_path, method, more, capsys):
    for part, seed in (("train", 0), ("train", 1), ("val", 2)):
        write_hdf5(tmp_path / "la" / part / f"c{seed}.h5", *volume(seed))
    words = [
        "run",
        "--data",
        str(tmp_path / "la"),
        "--logs",
        str(tmp_path / "logs.jsonl"),
        "--work",
        str(tmp_path / "w"),
    ]
    words += ["--steps", "2", "--patch", "16", "16", "16", "--batch", "2", "--filters", "2", "--seeds", "0"]
    options = ma.parser().parse_args([*words, "--methods", method, *more])
    jobs = ma.jobs(options)
    run_jobs(jobs, ma.work, options.logs, options.work, budget_s=60.0, on=["cpu"])
    (log,) = options.logs.trainings()
    assert set(log["largest"]) == {"c2"}
    assert f"| {method} (1) |" in ma.table_of(options.logs, "largest")
    assert method in METHODS
    assert log["job"]["settings"]["position"] == ("--position" in more)
    capsys.readouterr()


def test_logs_of_another_protocol_do_not_pass_for_done(tmp_path):
    logs = LogFile(tmp_path / "logs.jsonl")
    ma_log(logs, "baseline", 0, {"a": 0.9}, batch=2, optimizer="sgd", learning_rate=0.05, mirrors="")
    parse = ma.parser().parse_args
    words = ["run", "--steps", "2000", "--methods", "baseline", "--twins", "kept", "--seeds"]
    ma.refuse_others(ma.jobs(parse([*words, "0", "1"])), logs)
    ma.refuse_others(ma.jobs(parse([*words, "1", "--position"])), logs)
    with pytest.raises(SystemExit, match=r"baseline-0 in .*logs\.jsonl is of a training with other settings: choose"):
        ma.refuse_others(ma.jobs(parse([*words, "0", "--position"])), logs)


def test_the_page_s_command_goes_on_with_its_table():
    ma.refuse_others(ma.jobs(ma.parser().parse_args(["run", "--twins", "kept"])), ma.LOGS)


def test_coarse_centres_lie_between_fine_voxels():
    """A linear map keeps its values: the mean of the 8 voxels around a centre."""
    fine = torch.arange(16.0)[:, None, None] + torch.zeros(16, 16, 16)
    assert _at_coarse(fine, 4)[:, 0, 0].tolist() == [1.5 / 4, 5.5 / 4, 9.5 / 4, 13.5 / 4]


def test_enlarging():
    """Nearest doubles voxels; linear moves the surface to where the values cross zero."""
    values = torch.tensor([-1.0, 3.0])[:, None, None].expand(2, 2, 2)[None, None]
    nearest = juhl.enlarged(values, 8, "nearest")
    assert nearest[:, 0, 0].tolist() == [True] * 4 + [False] * 4
    # Centres of the coarse voxels are at 1.5 and 5.5; the zero is a quarter of the way.
    linear = juhl.enlarged(values, 8, "linear")
    assert linear[:, 0, 0].tolist() == [True] * 3 + [False] * 5


def test_the_maps_of_a_shape_agree():
    """Mesh, fine and coarse label tell of one surface: to a share of a voxel, each as well as it can."""
    shape = next(shapes("test", 96, 24, "cpu"))
    assert shape.truth is not None
    near = shape.targets["mesh"].abs() < 3
    assert near.sum() > 100
    error = {name: (shape.targets[name] - shape.targets["mesh"])[near].abs().mean() for name in ("voxels", "coarse")}
    assert error["voxels"] < 0.15
    assert error["voxels"] < error["coarse"] < 0.5
    assert torch.equal(shape.label, torch.nn.functional.avg_pool3d(shape.truth.float()[None], 4)[0] > 0.5)


def test_batches_of_shapes_are_turned_alike():
    source = [next(shapes("train", 16, 8, "cpu"))]
    batches = ShapeBatches(source, "mesh")
    one, again = (batches.batch(2, seed=0, step=s) for s in (3, 3))
    assert torch.equal(one.image, again.image)
    assert one.map is not None
    inside = one.map < 0
    # Where the exact distance is less than half a voxel, the label may say otherwise.
    sure = one.map.abs() > 0.2
    assert torch.equal(inside[sure], one.label[sure])


def test_scores_in_a_box_are_those_of_the_volume():
    from sdm.segmentation import scores_of

    truth = torch.zeros(40, 30, 50, dtype=torch.bool)
    truth[15:25, 10:20, 20:30] = True
    prediction = truth.roll((1, 2), (0, 2))
    assert juhl.score(prediction, truth) == pytest.approx(scores_of(prediction, truth, (1.0, 1.0, 1.0)))


def test_the_table_of_shapes(tmp_path):
    case = {"dice": 0.9, "contour_dice": 0.8, "average_surface_distance_mm": 1.0, "rms_surface_distance_mm": 2.0}
    logs = LogFile(tmp_path / "logs.jsonl")
    logs.put({"job": {"name": "a", "network": "pwc"}, "nearest": [case], "linear": [case]})
    lines = juhl.table_of(logs).splitlines()
    assert lines[2] == "| PWC (CE + Dice; published: CE), nearest (1) | 90.00 | 80.00 | 1.00 | 2.00 |"


def test_packed_cases_come_back(tmp_path):
    import h5py

    whole = np.random.default_rng(0).integers(0, 200, (9, 8, 7)).astype(np.float64)
    whole.flat[:3] = (0, 1, 199)
    label = (whole > 100).astype(np.uint8)
    write_hdf5(tmp_path / "la" / "train" / "a.h5", ((whole - 77) / 31.7).astype(np.float32), label)
    pack(tmp_path / "la", tmp_path / "la.npz")
    unpack(tmp_path / "la.npz", tmp_path / "again")
    with h5py.File(tmp_path / "again" / "train" / "a.h5") as file:
        assert np.array_equal(file["image"], whole)
        assert np.array_equal(file["label"], label)


def test_work_is_told_the_deadline(tmp_path):
    seen = []
    run_jobs(
        [{"name": "x"}],
        lambda job, device, unfinished, kept, deadline: seen.append(deadline),
        LogFile(tmp_path / "logs.jsonl"),
        tmp_path,
        budget_s=5.0,
        on=["cpu"],
    )
    assert 0 < seen[0] - time.monotonic() <= 5.0


def ma_log(file: LogFile, method: str, seed: int, dice: dict[str, float], **changes) -> None:
    job = {
        "name": f"{method}-{seed}",
        "settings": ma.Settings(method=method, seed=seed, **changes).record(),
    }
    cases = {
        name: {
            "dice": value,
            "jaccard": value,
            "contour_dice": value,
            "hausdorff95_mm": 10 * (1 - value),
            "average_surface_distance_mm": 1.0,
        }
        for name, value in dice.items()
    }
    log = {"job": job, "training_s": 1.0, "machine": {"device": "abacus"}, "largest": cases, "plain": cases}
    file.put(log)


def logs_of(folder: Path, name: str) -> LogFile:
    return LogFile(folder / f"{name}.jsonl")


def trial(folder: Path, name: str) -> LogFile:
    return LogFile(folder / "trials.jsonl", name)


def test_the_report_compares_case_by_case(tmp_path):
    """Differences of 0.01 to 0.04: mean 2.5 %, of the hard half 3.5 %."""
    own, none = LogFile(tmp_path / "ma.jsonl"), LogFile(tmp_path / "none.jsonl")
    for seed in (0, 1):
        ma_log(own, "baseline", seed, {"a": 0.8, "b": 0.82, "c": 0.9, "d": 0.92})
        ma_log(own, "pwr", seed, {"a": 0.84, "b": 0.85, "c": 0.92, "d": 0.93})
    ma_log(own, "boundary", 7, {"a": 0.5})
    text = report.page(own, none, none)
    row, without = [line for line in text.splitlines() if line.startswith("| pwr | +")]
    assert row.startswith("| pwr | +2.50 [+0.45, +4.55] | 0.125 | +3.50 | +1.50 | -0.25 [")
    assert "The same without a:" in text
    assert without.startswith("| pwr | +2.00 [")
    assert "| pwr | 88.5, 88.5 | +2.5, +2.5 | 90.00 (+2.00) | 1.1, 1.1 | -0.2, -0.2 | 1.00 (-0.20) |" in text
    # No seed in common: no comparison, but a row in the table.
    assert "| boundary |" not in text
    assert "| boundary (1) |" in text
    assert "on abacus." in text


def test_rows_with_more_seeds_are_compared_by_those_that_all_have(tmp_path):
    """By seeds 0 and 1 PWR is 5 % better; with seed 2, which it lacks, the baseline would be as good."""
    for seed, low in enumerate((0.8, 0.8, 0.95)):
        ma_log(logs_of(tmp_path, "whole"), "baseline", seed, {"a": low, "b": low}, coarsen=2)
        ma_log(logs_of(tmp_path, "ma"), "baseline", seed, {"a": 0.7, "b": 0.7})
    for seed in (0, 1):
        ma_log(logs_of(tmp_path, "whole"), "pwr", seed, {"a": 0.86, "b": 0.84}, coarsen=2)
    text = report.page(
        logs_of(tmp_path, "ma"), logs_of(tmp_path, "none"), logs_of(tmp_path, "none"), logs_of(tmp_path, "whole")
    )
    whole = text[text.index("### Whole volumes") :]
    assert "of voxels 2 times as large" in whole
    assert "| baseline (3) | 85.00" in whole
    assert "case by case (largest component), by the 2 seeds that all rows have:" in whole
    assert "| pwr | +5.00 [" in whole
    assert "| pwr | 85.0, 85.0 | +5.0, +5.0 |" in whole
    assert "Whole volumes" not in report.page(
        logs_of(tmp_path, "ma"), logs_of(tmp_path, "none"), logs_of(tmp_path, "none")
    )


def test_the_report_tells_what_other_protocols_changed(tmp_path):
    """Two halves with one setting each; 95HD is 10 (1 - Dice) here, and case b moves most."""
    ma_log(logs_of(tmp_path, "ma"), "baseline", 0, {"a": 0.9, "b": 0.9})
    for seed, (mirrors, low) in enumerate([("", 0.8), ("xyz", 0.5), ("", 0.8), ("xyz", 0.5)]):
        ma_log(trial(tmp_path, "half"), "baseline", seed, {"a": 0.9, "b": low}, mirrors=mirrors)
    ma_log(trial(tmp_path, "short"), "pwr", 1, {"a": 0.8, "b": 0.6}, steps=100, mirrors="x", optimizer="sgd")
    text = report.page(logs_of(tmp_path, "ma"), logs_of(tmp_path, "none"), logs_of(tmp_path, "trials"))
    assert "| short | 100 steps, sgd, mirrored along x | pwr (1) | 70.00 | 3.00 | 70.0, 3.0 | 80.00, 2.00 |" in text
    assert "| short (1) | 2.0 | 4.0 |" in text
    assert "| mirrored along xyz | not mirrored | +15.00 | -1.50 | +0.00, +0.00 |" in text
    assert "4 trainings of half" in text


def test_a_folder_of_trials_is_compared_with_its_own_baseline(tmp_path):
    """One seed is enough of a whole table, and a folder without a baseline has nothing to compare with."""
    for seed in (0, 1):
        for method in ("baseline", "pwr"):
            ma_log(logs_of(tmp_path, "ma"), method, seed, {"a": 0.8, "b": 0.9})
            ma_log(trial(tmp_path, "position"), method.replace("baseline", "pwc"), seed, {"a": 0.8, "b": 0.9})
    for method in MA_ROWS:
        ma_log(trial(tmp_path, "adam"), method, 0, {"a": 0.8, "b": 0.9}, steps=5)
    text = report.page(logs_of(tmp_path, "ma"), logs_of(tmp_path, "none"), logs_of(tmp_path, "trials"))
    assert "| position (4) |" in text
    assert "seeds of position" not in text
    assert "The baseline is not there yet." not in text
    assert "Against the baseline, case by case, one seed of adam:" in text


@pytest.mark.parametrize("seeds", [1, 2])
def test_the_picture_of_atria(tmp_path, seeds):
    pytest.importorskip("matplotlib")
    for seed in range(seeds):
        for method, low in (("baseline", 0.8), ("pwr", 0.85), ("head-sdf-l1", 0.7)):
            ma_log(logs_of(tmp_path, "ma"), method, seed, {"a": low, "b": 0.9})
    plots.draw_atrium(logs_of(tmp_path, "ma").trainings(), tmp_path / "atrium.png", "A title")
    assert (tmp_path / "atrium.png").stat().st_size > 1000


def test_a_training_that_was_done_twice(tmp_path):
    """Dice of 80 and 84 has a deviation of 2 sqrt(2); 95HD is 10 (1 - Dice) here."""
    for number, low in enumerate((0.8, 0.88)):
        ma_log(logs_of(tmp_path, str(number)), "pwr", 3, {"a": low, "b": 0.8})
        ma_log(logs_of(tmp_path, str(number)), "pwr", 4 + number, {"a": low, "b": 0.8})
    folders = {name: logs_of(tmp_path, name).trainings() for name in ("0", "1")}
    lines = repeats_table(folders, "a").splitlines()
    assert lines[2:-2] == ["| pwr-3 | 0, 1 | 80.0, 84.0 | 2.0, 1.6 | 80.0, 2.0; 80.0, 2.0 |"]
    assert "2.83 % Dice and 0.28 voxels (0.00 and 0.00 without a)." in lines[-1]
    assert repeats_table({"0": folders["0"]}, "a") == ""


def test_what_chance_does_to_a_table():
    """Simulated: rows that are alike but for their seeds' share, which is larger than what is left."""
    random = np.random.default_rng(0)
    deviations, two, furthest = [], [], []
    for _ in range(1000):
        values = random.normal(0, 3, (1, 3)) + random.normal(0, 1, (18, 3))
        spread = spread_of(values)
        less = abs(values.mean(1)[1:] - values.mean(1)[0])
        deviations.append(spread.deviation)
        two.append(less[0] > spread.two)
        furthest.append(less.max() > spread.furthest)
    assert np.mean(deviations) == pytest.approx(1.0, abs=0.02)
    assert np.mean(two) == pytest.approx(0.05, abs=0.02)
    # Bonferroni is on the safe side: all rows have the baseline in common.
    assert 0.01 < np.mean(furthest) < 0.05


def test_logs_of_before_a_choice_have_its_default(tmp_path):
    own = logs_of(tmp_path, "ma")
    ma_log(own, "baseline", 0, {"a": 0.9})
    (log,) = own.trainings()
    settings = log["job"]["settings"]
    del settings["mirrors"], settings["average"], settings["position"]
    assert differs(log, log) == "as in the table"
    other = {"job": {"settings": {**settings, "mirrors": "", "average": 0.1}}}
    assert differs(other, log) == "weights averaged over 0.1, not mirrored"
    assert differs({"job": {"settings": {**settings, "position": True}}}, log) == "told positions"
