"""Ensembles over networks of several protocols in the study of left atria: who may stand beside whom, logs, tables."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch

from sdm.bench.segmentation import ma, report
from sdm.bench.segmentation.log_file import LogFile, short
from sdm.segmentation import Settings, TrainedModel, load_model, predict, read_cases, save_model, validate_ensemble
from tests.helpers.segmentation_cases import volume, write_hdf5

CUBE = (16, 16, 16)
SPACING = (1.0, 1.0, 1.0)
COARSE = {"coarsen": 2, "patch": (32, 16, 16), "augment": "strong"}


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("atria")
    write_hdf5(folder / "val" / "c2.h5", *volume(2))
    return folder


def keep(folder: Path, *names: str, **changes) -> Path:
    """Untrained networks, METHOD-SEED, but of two minds: some of an image is foreground to them."""
    folder.mkdir(exist_ok=True)
    for name in names:
        method, seed = name.rsplit("-", 1)
        own = Settings(
            **{
                "method": method,
                "seed": int(seed),
                "patch": CUBE,
                "mirrors": "",
                "filters": 2,
                "architecture": "unet",
                **changes,
            }
        )
        with torch.random.fork_rng():
            torch.manual_seed(own.seed)
            model = own.network().eval()
        with torch.no_grad():
            model.main.weight.mul_(20.0)
            image = torch.from_numpy(volume(2)[0])
            assert model.main.bias is not None
            model.main.bias.sub_(predict(model, image, own.patch).field.median())
        save_model(TrainedModel(model, own, SPACING), folder / f"{name}.pt")
    return folder


@pytest.fixture
def mix(data, tmp_path, monkeypatch, capsys):
    """Averages the networks of folders, and gives what the command prints."""

    def run(*more: str | Path, what: str = "ensemble") -> str:
        places = [
            "--data",
            data,
            "--work",
            tmp_path / "work",
            "--keep",
            tmp_path / "fine",
            "--logs",
            tmp_path / "mixed.jsonl",
        ]
        monkeypatch.setattr(sys, "argv", ["segmentation_ma", what, "--gpus", "0", *map(str, [*places, *more])])
        ma.main()
        return capsys.readouterr().out

    return run


def test_fine_and_coarse_networks_together(mix, data, tmp_path):
    fine = keep(tmp_path / "fine", "baseline-0", "baseline-1", "head-sdf-l1-0", architecture="vnet")
    coarse = keep(
        tmp_path / "coarse", "baseline-0", "baseline-4", "head-sdf-l1-2", "boundary-0", **COARSE, architecture="vnet"
    )
    said = mix("--beside", coarse)
    assert "2 of 2 jobs to do" in said
    logs = LogFile(tmp_path / "mixed.jsonl").ensembles()
    assert [log["job"]["name"] for log in logs] == ["baseline-ensemble", "head-sdf-l1-ensemble"]
    assert LogFile(tmp_path / "mixed.jsonl").trainings() == []
    # As the library has it, each in windows of its own patch.
    files = [fine / "baseline-0.pt", fine / "baseline-1.pt", coarse / "baseline-0.pt", coarse / "baseline-4.pt"]
    networks = [load_model(file) for file in files]
    ((_, plain, largest),) = validate_ensemble(networks, read_cases(data, "val"))
    assert (logs[0]["plain"]["c2"], logs[0]["largest"]["c2"]) == (short(plain), short(largest))
    assert 0 < plain["dice"] < 1
    ((_, of_one_kind, _),) = validate_ensemble(networks[:2], read_cases(data, "val"))
    assert short(of_one_kind) != short(plain)
    # Settings and seeds of both.
    job = logs[0]["job"]
    (beside,) = job["beside"]
    assert (job["seeds"], beside["seeds"]) == ([0, 1], [0, 4])
    for group, like in ((job, networks[0].settings), (beside, networks[2].settings)):
        assert "seed" not in group["settings"]
        assert Settings.of_record({**group["settings"], "seed": like.seed}) == like
    assert not {"data", "networks"} & set(job)
    assert "| mixed | baseline (0, 1 + 0, 4) |" in said
    assert "patches 32x16x16, voxels 2 times as large" in said
    assert "no logs in" not in said
    # The same windows for all, if the command says so.
    mix("--beside", coarse, "--logs", tmp_path / "windows.jsonl", "--window", "16", "16", "16", "--methods", "baseline")
    (log,) = LogFile(tmp_path / "windows.jsonl").ensembles()
    ((_, plain, _),) = validate_ensemble(networks, read_cases(data, "val"), window=CUBE)
    assert log["plain"]["c2"] == short(plain)


def test_mirror_images_that_one_kind_knows(mix, data, tmp_path):
    fine = keep(tmp_path / "fine", "baseline-0")
    other = keep(tmp_path / "other", "baseline-0", mirrors="x")
    mix("--beside", other)
    (log,) = LogFile(tmp_path / "mixed.jsonl").ensembles()
    assert log["job"]["mirrors"] == "x"
    networks = [load_model(folder / "baseline-0.pt") for folder in (fine, other)]
    ((_, plain, _),) = validate_ensemble(networks, read_cases(data, "val"), mirrors=True)
    assert log["plain"]["c2"] == short(plain)


def test_what_is_done_is_skipped_and_done_again_with_a_further_seed(mix, tmp_path):
    keep(tmp_path / "fine", "baseline-0")
    coarse = keep(tmp_path / "coarse", "baseline-0", **COARSE)
    third = keep(tmp_path / "third", "baseline-0", steps=7)
    assert "1 of 1 jobs to do" in mix("--beside", coarse, third)
    assert "0 of 0 jobs to do" in mix("--beside", coarse, third)
    keep(coarse, "baseline-1", **COARSE)
    assert "1 of 1 jobs to do" in mix("--beside", coarse, third)
    (log,) = LogFile(tmp_path / "mixed.jsonl").ensembles()
    assert [group["seeds"] for group in log["job"]["beside"]] == [[0, 1], [0]]
    assert "baseline (0 + 0, 1 + 0)" in mix("--beside", coarse, third)
    assert "0 of 0 jobs to do" in mix("--beside", coarse, third, "--seeds", "0")
    (coarse / "baseline-0.pt").unlink()
    assert "0 of 0 jobs to do" in mix("--beside", coarse, third)
    with pytest.raises(SystemExit, match=r"baseline-ensemble in .*mixed\.jsonl is of a training with other settings"):
        mix("--beside", coarse)
    keep(tmp_path / "fine", "baseline-1")
    with pytest.raises(SystemExit, match=r"baseline-ensemble in .*mixed\.jsonl is of a training with other settings"):
        mix()


def test_methods_that_are_left_out(mix, tmp_path):
    keep(tmp_path / "fine", "baseline-0", "pwr-0", "boundary-0")
    coarse = keep(tmp_path / "coarse", "baseline-0", "pwr-0", **COARSE)
    said = mix("--beside", coarse)
    assert f"boundary is left out: no network of it is kept in {coarse}\n" in said
    (line,) = [line for line in said.splitlines() if line.startswith("pwr is left out")]
    assert "which have no mean" in line
    assert str(coarse / "pwr-0.pt") in line
    assert [log["job"]["name"] for log in LogFile(tmp_path / "mixed.jsonl").ensembles()] == ["baseline-ensemble"]


def test_folders_that_are_refused(mix, tmp_path, monkeypatch):
    fine = keep(tmp_path / "fine", "baseline-0", "baseline-1")
    coarse = keep(tmp_path / "coarse", "baseline-0", **COARSE)
    with pytest.raises(SystemExit, match="say ensemble in place of run"):
        mix("--beside", coarse, what="run")
    with pytest.raises(SystemExit, match="named twice in --keep and --beside"):
        mix("--beside", coarse, fine)
    with pytest.raises(SystemExit, match="holds no networks of these methods"):
        mix("--beside", tmp_path / "none")
    monkeypatch.setattr(ma, "LOGS", LogFile(tmp_path / "mixed.jsonl"))
    with pytest.raises(SystemExit, match=r"mixed\.jsonl has the logs of trainings: choose a file of their own"):
        mix("--beside", coarse)
    assert not (tmp_path / "mixed.jsonl").exists()
    monkeypatch.undo()
    log(LogFile(tmp_path / "mixed.jsonl"), "baseline-0", 0.8, 9.0, {})
    with pytest.raises(SystemExit, match=r"mixed\.jsonl has the logs of trainings: choose a file of their own"):
        mix("--beside", coarse)
    (tmp_path / "mixed.jsonl").unlink()
    keep(coarse, "baseline-1")
    with pytest.raises(SystemExit, match=r"baseline-1\.pt are of trainings whose settings differ in more than the"):
        mix("--beside", coarse)


def log(file: LogFile, name: str, dice: float, distance: float, changes: dict, **job) -> None:
    """Of a training, METHOD-SEED, or of an ensemble."""
    method, seed = name.rsplit("-", 1)
    settings = Settings(**{"method": method, "seed": int(seed) if seed.isdigit() else 0, **changes}).record()
    scores = {"dice": dice, "jaccard": dice, "contour_dice": dice, "average_surface_distance_mm": 1.0}
    cases = {c: {**scores, "hausdorff95_mm": distance + more} for c, more in (("5UB5X", 6.0), ("6799X", 0.0))}
    found = {"training_s": 1.0, "machine": {"device": "abacus"}, "largest": cases, "plain": cases}
    file.put({"job": {"name": name, "settings": settings, **job}, **found})


def test_the_report_has_mixtures_apart(tmp_path):
    main, trials, none = (LogFile(tmp_path / f"{name}.jsonl") for name in ("ma", "trials", "none"))
    coarse = {"coarsen": 4, "patch": (64, 48, 32)}
    for method in ("baseline", "pwr"):
        for seed, distance in enumerate((10.0, 20.0)):
            log(main, f"{method}-{seed}", 0.8, distance, {})
            log(LogFile(trials.path, "coarse"), f"{method}-{seed}", 0.7, distance, coarse)
    # Once more: the first counts.
    log(LogFile(trials.path, "later"), "baseline-0", 0.1, 50.0, coarse)
    log(main, "baseline-ensemble", 0.9, 8.0, {}, seeds=[0, 1])
    before = report.page(main, none, trials)
    assert "several protocols" not in before
    beside = {"settings": Settings(**coarse).record(), "seeds": [0, 1]}
    log(LogFile(trials.path, "mixed"), "baseline-ensemble", 0.95, 5.0, {}, seeds=[0, 1], beside=[beside])
    # Of a training there is no log.
    log(LogFile(trials.path, "mixed"), "pwr-ensemble", 0.9, 6.0, {}, seeds=[0, 2], beside=[beside])
    text = report.page(main, none, trials)
    start, end = text.index("### Ensembles of several protocols"), text.index("## Simple shapes")
    assert text[:start] + text[end:] == before
    lines = text[start:end].splitlines()
    assert lines[2] == "- mixed: as in the table + patches 64x48x32, voxels 4 times as large"
    assert lines[3] == ""
    row = "| mixed | baseline (0, 1 + 0, 1) | 95.00 | 75.00 | 8.00 | 18.00 | 95.00, 5.00 | 75.00, 15.00 |"
    assert row in lines
    assert "| mixed | pwr (0, 2 + 0, 1) | 90.00 | - | 9.00 | - | 90.00, 6.00 | - |" in lines
    assert "| logs | method (seeds) | 5UB5 | 6799 |" in lines
    assert "| mixed | baseline (0, 1 + 0, 1) | 11.0 (21.0) | 5.0 (15.0) |" in lines
