"""Ensembles of the study of left atria: networks are kept, averaged over seeds, and told apart from trainings."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from sdm.bench.segmentation import ma, report
from sdm.bench.segmentation.ensembles import ensemble_after, ensemble_jobs
from sdm.bench.segmentation.log_file import LogFile, short
from sdm.segmentation import load_model, read_cases, validate, validate_ensemble
from tests.helpers.segmentation_cases import volume, write_hdf5

QUICK = "--steps 2 --patch 16 16 16 --batch 2 --filters 2 --mirrors= --optimizer sgd --learning-rate 0.05 --gpus 0"


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("atria")
    for part, seed in (("train", 0), ("train", 1), ("val", 2)):
        write_hdf5(folder / part / f"c{seed}.h5", *volume(seed))
    return folder


@pytest.fixture
def study(data, tmp_path, monkeypatch, capsys):
    """Runs the command, and gives what it prints."""
    places = [
        "--data",
        data,
        "--logs",
        tmp_path / "logs.jsonl",
        "--work",
        tmp_path / "work",
        "--keep",
        tmp_path / "keep",
    ]

    def run(what: str, *more: str) -> str:
        words = ["segmentation_ma", what, *map(str, places), *(QUICK.split() if what == "run" else ["--gpus", "0"])]
        monkeypatch.setattr(sys, "argv", [*words, *more])
        ma.main()
        return capsys.readouterr().out

    return run


TWO = ("--methods", "baseline", "pwr", "--seeds", "0", "1")


def test_a_run_with_ensembles(study, data, tmp_path):
    said = study("run", "--ensemble", *TWO)
    names = [line.split(":")[0] for line in said.splitlines() if " s on cpu" in line]
    # Each as soon as its seeds are there.
    assert names == ["baseline-0", "pwr-0", "baseline-1", "baseline-ensemble", "pwr-1", "pwr-ensemble"]
    logs, keep = LogFile(tmp_path / "logs.jsonl"), tmp_path / "keep"
    assert sorted(p.name for p in keep.iterdir()) == ["baseline-0.pt", "baseline-1.pt", "pwr-0.pt", "pwr-1.pt"]
    trainings, ensembles = logs.trainings(), logs.ensembles()
    assert [log["job"]["name"] for log in trainings] == ["baseline-0", "baseline-1", "pwr-0", "pwr-1"]
    assert [log["job"]["name"] for log in ensembles] == ["baseline-ensemble", "pwr-ensemble"]
    cases = read_cases(data, "val")
    for log in trainings:
        ((_, plain, largest),) = validate(load_model(keep / f"{log['job']['name']}.pt").model, cases, (16, 16, 16))
        assert (short(plain), short(largest)) == (short(log["plain"]["c2"]), short(log["largest"]["c2"]))
    for log in ensembles:
        settings = log["job"]["settings"]
        networks = [load_model(keep / f"{settings['method']}-{seed}.pt") for seed in (0, 1)]
        ((_, plain, largest),) = validate_ensemble(networks, cases)
        assert (short(plain), short(largest)) == (short(log["plain"]["c2"]), short(log["largest"]["c2"]))
        assert log["job"]["seeds"] == [0, 1]
        assert "seed" not in settings
        assert settings["steps"] == 2
        assert log["job"]["mirrors"] == ""
        assert not {"data", "networks"} & set(log["job"])
    assert "| baseline (2) |" in said
    assert "| logs | baseline (0, 1) |" in said


def test_ensembles_of_networks_that_are_kept(study, tmp_path):
    """Finished ensembles are skipped, and computed again with a further seed."""
    study("run", *TWO, "--seeds", "0", "1", "2")
    logs = LogFile(tmp_path / "logs.jsonl")
    assert logs.ensembles() == []
    said = study("ensemble", *TWO)
    assert "2 of 2 jobs to do" in said
    first = [log for log in logs.ensembles() if log["job"]["name"] == "pwr-ensemble"]
    logs.remove("baseline-ensemble")
    said = study("ensemble", *TWO)
    assert "1 of 1 jobs to do" in said
    assert [log for log in logs.ensembles() if log["job"]["name"] == "pwr-ensemble"] == first
    said = study("ensemble")
    assert "2 of 2 jobs to do" in said
    assert [log["job"]["seeds"] for log in logs.ensembles()] == [[0, 1, 2], [0, 1, 2]]
    # Fewer seeds than before: it stays.
    (tmp_path / "keep" / "pwr-2.pt").unlink()
    assert "0 of 0 jobs to do" in study("ensemble")
    (tmp_path / "keep" / "pwr-1.pt").unlink()
    assert "fewer than two networks are kept of pwr: no ensemble" in study("ensemble")


def test_no_ensemble_without_time(study, tmp_path):
    study("run", *TWO)
    assert "no time is left for baseline-ensemble, pwr-ensemble" in study("ensemble", "--budget-s", "0")
    assert LogFile(tmp_path / "logs.jsonl").ensembles() == []


def test_an_ensemble_follows_its_last_training(tmp_path):
    words = ["run", "--methods", "baseline", "pwr", "--seeds", "0", "1", "2"]
    listed = ma.jobs(ma.parser().parse_args(words))
    logs = LogFile(tmp_path / "logs.jsonl")
    for seed in (0, 2):
        (tmp_path / f"pwr-{seed}.pt").touch()
    assert ensemble_after(listed[1], listed=listed, keep=tmp_path, logs=logs) is None
    (found,) = ensemble_jobs(listed, tmp_path, logs)
    assert found["seeds"] == [0, 2]
    (tmp_path / "pwr-1.pt").touch()
    job = ensemble_after(listed[1], listed=listed, keep=tmp_path, logs=logs)
    assert job is not None
    assert (job["name"], job["seeds"]) == ("pwr-ensemble", [0, 1, 2])
    assert [Path(path).name for path in job["networks"]] == ["pwr-0.pt", "pwr-1.pt", "pwr-2.pt"]


def test_other_protocols_are_refused(study, tmp_path):
    with pytest.raises(SystemExit, match="holds no networks of these methods"):
        study("ensemble")
    study("run", "--ensemble", *TWO, "--methods", "baseline")
    logs, keep = LogFile(tmp_path / "logs.jsonl"), tmp_path / "keep"
    with pytest.raises(SystemExit, match=r"baseline-0\.pt is of a training with other settings"):
        study("run", "--logs", str(tmp_path / "other.jsonl"), "--methods", "baseline", "--steps", "3")
    for seed in (0, 1):
        logs.remove(f"baseline-{seed}")
    with pytest.raises(SystemExit, match=r"baseline-ensemble in .*logs\.jsonl is of a training with other settings"):
        study("run", "--ensemble", "--keep", str(tmp_path / "k"), "--methods", "baseline", "--steps", "3")
    study(
        "run", "--logs", str(tmp_path / "l.jsonl"), "--keep", str(tmp_path / "k"), *TWO, "--seeds", "2", "--steps", "3"
    )
    (tmp_path / "k" / "baseline-2.pt").rename(keep / "baseline-2.pt")
    with pytest.raises(SystemExit, match=r"baseline-2\.pt are of trainings whose settings differ in more than the"):
        study("ensemble")
    (keep / "baseline-2.pt").rename(keep / "baseline-3.pt")
    with pytest.raises(SystemExit, match=r"holds the network of baseline-2: call it baseline-2\.pt"):
        study("ensemble")


@pytest.mark.parametrize("words", [["ensemble"], ["run", "--ensemble"]])
def test_ensembles_want_a_folder(monkeypatch, words):
    monkeypatch.setattr(sys, "argv", ["segmentation_ma", *words])
    with pytest.raises(SystemExit, match="give a folder with --keep"):
        ma.main()


def ma_log(file: LogFile, name: str, dice: float, distance: float | str, **job) -> None:
    method, seed = name.rsplit("-", 1)
    settings = ma.Settings(method=method, seed=0 if "seeds" in job else int(seed)).record()
    scores = {"dice": dice, "jaccard": dice, "contour_dice": dice, "hausdorff95_mm": distance}
    cases = {case: {**scores, "average_surface_distance_mm": 1.0} for case in ("first", "second")}
    log = {"training_s": 1.0, "machine": {"device": "abacus"}, "largest": cases, "plain": cases}
    file.put({"job": {"name": name, "settings": settings, **job}, **log})


def test_the_report_has_ensembles_apart(tmp_path):
    main, trials, none = (LogFile(tmp_path / f"{name}.jsonl") for name in ("ma", "trials", "none"))
    sgd, alone = (LogFile(trials.path, name) for name in ("sgd", "alone"))
    for file in (main, sgd):
        for seed, distance in enumerate((10, 20)):
            ma_log(file, f"baseline-{seed}", 0.8, distance)
            ma_log(file, f"pwr-{seed}", 0.7, distance)
    before = report.page(main, none, trials)
    ma_log(main, "baseline-ensemble", 0.9, 8.0, seeds=[0, 1])
    ma_log(sgd, "pwr-ensemble", 0.6, "inf", seeds=[0, 1])
    ma_log(sgd, "baseline-ensemble", 0.85, 9.0, seeds=[0, 2])
    ma_log(alone, "pwr-ensemble", 0.6, 7.0, seeds=[5, 6])
    text = report.page(main, none, trials)
    start, end = text.index("### Ensembles"), text.index("## Simple shapes")
    assert text[:start] + text[end:] == before
    lines = text[start:end].splitlines()
    assert "| the table | baseline (0, 1) | 90.00 | 80.00 | 8.00 | 15.00 | 90.00, 8.00 | 80.00, 15.00 |" in lines
    assert "| sgd | pwr (0, 1) | 60.00 | 70.00 | 80.00 | 15.00 | 60.00, 80.00 | 70.00, 15.00 |" in lines
    # The log of one of its trainings is not there.
    assert "| sgd | baseline (0, 2) | 85.00 | - | 9.00 | - | 85.00, 9.00 | - |" in lines
    assert "| alone | pwr (5, 6) | 60.00 | - | 7.00 | - | 60.00, 7.00 | - |" in lines
    assert "| the table | baseline (0, 1) | 8.0 (15.0) | 8.0 (15.0) |" in lines
    assert "| sgd | baseline (0, 2) | 9.0 (-) | 9.0 (-) |" in lines
