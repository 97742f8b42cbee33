"""Ensembles of Ma's rows: the mean over a method's seeds, of networks that their trainings kept.

A training keeps its network as METHOD-SEED.pt; the log of their mean is METHOD-ensemble, beside those of the trainings.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sdm.bench.common.machine import describe
from sdm.bench.deepsdf.study.atria_split import read_record, twins_of
from sdm.bench.segmentation.log_file import Job, LogFile, groups_of
from sdm.bench.segmentation.pack import packed_cases, shapes_of
from sdm.segmentation import METHODS, Case, Settings, cell, check_cases, load_model, load_settings, read_cases
from sdm.segmentation import validate_ensemble as validate

# Seconds of an ensemble of three seeds where processes share a GPU: there a training's own prediction took 1 to 7.
ENSEMBLE_S = 15.0


def kept_file(keep: Path, job: Job) -> Path:
    """Path of the network that a training keeps."""
    return keep / f"{job['name']}.pt"


def kept_trainings(keep: Path, like: Job, methods: Sequence[str], seeds: Sequence[int] | None) -> list[Job]:
    """The trainings whose networks a folder has, by method and seed; beside name and settings as the job `like`."""
    found = []
    for path in sorted(keep.glob("*.pt")):
        settings = load_settings(path)
        name = f"{settings.method}-{settings.seed}"
        if path.stem != name:
            raise SystemExit(f"{path} holds the network of {name}: call it {name}.pt")
        if settings.method in methods and (seeds is None or settings.seed in seeds):
            found.append({**like, "name": name, "settings": settings.record(), "mirrors": settings.mirrors})
    if not found:
        raise SystemExit(f"{keep} holds no networks of these methods and seeds: train them with run --keep {keep}")
    order = list(METHODS)
    return sorted(found, key=lambda job: (order.index(job["settings"]["method"]), job["settings"]["seed"]))


def refuse_other_networks(listed: Sequence[Job], keep: Path) -> None:
    """A network of another protocol must not be averaged with those of this one."""
    for job in listed:
        path = kept_file(keep, job)
        if path.is_file() and load_settings(path) != Settings.of_record(job["settings"]):
            raise SystemExit(f"{path} is of a training with other settings: choose another folder with --keep")


def as_ensemble(own: Sequence[Job], keep: Path) -> Job:
    """The job of the mean over trainings of one method."""
    first = own[0]
    settings = {key: value for key, value in first["settings"].items() if key != "seed"}
    for job in own[1:]:
        if {key: value for key, value in job["settings"].items() if key != "seed"} != settings:
            raise SystemExit(
                f"{kept_file(keep, first)} and {kept_file(keep, job)} are of trainings whose settings differ in more "
                "than the seed: keep them in folders of their own"
            )
    return {
        **first,
        "name": f"{settings['method']}-ensemble",
        "settings": settings,
        "seeds": [job["settings"]["seed"] for job in own],
        "networks": [str(kept_file(keep, job)) for job in own],
    }


def ensemble_jobs(listed: Sequence[Job], keep: Path, logs: LogFile, *, complete: bool = False) -> list[Job]:
    """An ensemble for each method of which two or more trainings, if `complete` all that are listed, kept a network.

    Those whose log has these seeds, or some that are not kept any more, are left out: they are done.
    """
    found = []
    for own in by_method(listed).values():
        kept = [job for job in own if kept_file(keep, job).is_file()]
        if len(kept) < (max(2, len(own)) if complete else 2):
            continue
        found.append(as_ensemble(kept, keep))
    return not_done(found, logs)


def not_done(jobs: Sequence[Job], logs: LogFile) -> list[Job]:
    """Ensembles without those whose log has their seeds, or some that are not kept any more."""
    known = {log["job"]["name"]: _seeds(log["job"]) for log in logs.ensembles()}
    return [job for job in jobs if _seeds(job) > known.get(job["name"], set())]


def _seeds(job: Job) -> set[tuple[int, int]]:
    """Each with the number of its protocol."""
    return {(at, seed) for at, group in enumerate(groups_of(job)) for seed in group["seeds"]}


def too_few(listed: Sequence[Job], keep: Path) -> list[str]:
    """Methods of which fewer than two networks are kept."""
    methods = by_method(listed).items()
    return [name for name, own in methods if sum(kept_file(keep, job).is_file() for job in own) < 2]


def by_method(listed: Sequence[Job]) -> dict[str, list[Job]]:
    """In the order in which they come."""
    found: dict[str, list[Job]] = {}
    for job in listed:
        found.setdefault(job["settings"]["method"], []).append(job)
    return found


def ensemble_after(job: Job, *, listed: Sequence[Job], keep: Path, logs: LogFile) -> Job | None:
    """The ensemble of a method, once its last training is done."""
    own = [other for other in listed if other["settings"]["method"] == job["settings"]["method"]]
    return next(iter(ensemble_jobs(own, keep, logs, complete=True)), None)


def seeds_of(job: Job) -> str:
    """Those of an ensemble's networks, with a plus between protocols: 0, 1, 2 + 0, 1."""
    return " + ".join(", ".join(map(str, group["seeds"])) for group in groups_of(job))


def cases_of(job: Job, part: str, kept: dict[str, Any]) -> list[Case]:
    """The cases to train or to validate on, read once in a process; with `twins` "apart" without those' near twins."""
    if part not in kept:
        data = Path(job["data"])
        cases = packed_cases(data, part) if data.is_file() else read_cases(data, part)
        if part == "train" and job.get("twins") == "apart":
            near = twins_of(read_record(), [case.name for case in cases_of(job, "val", kept)])
            cases = [case for case in cases if case.name not in near]
        cases = cases[: job["cases"]]
        check_cases(cases)
        kept[part] = cases
    return kept[part]


def shapes_for(job: Job, kept: dict[str, Any]) -> list[Tensor]:
    """Labels without images for synthetic cases, read once in a process: no near twins of validation cases."""
    if "shapes" not in kept:
        near = twins_of(read_record(), [case.name for case in cases_of(job, "val", kept)])
        found = shapes_of(Path(job["data"]))
        kept["shapes"] = [label for name, label in found.items() if name not in near]
        if not kept["shapes"]:
            raise SystemExit(f"{job['data']} holds no labels without images: synthetic cases need DIR/labels/*.npz")
    return kept["shapes"]


def ensemble(job: Job, device: str, kept: dict[str, Any]) -> dict[str, Any]:
    """The scores of an ensemble."""
    cases = cases_of(job, "val", kept)
    begin = time.monotonic()
    networks = [load_model(Path(path), device) for path in job["networks"]]
    if device.startswith("cuda"):
        for one in networks:
            one.model.to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]
    scores = list(
        validate(networks, cases, window=job["window"], stride=job["stride"], mirrors=bool(job["mirrors"])),
    )
    largest = {name: score for name, _, score in scores}
    values = list(largest.values())
    seeds = seeds_of(job)
    return {
        "summary": f"Dice {cell(values, 'dice')}, 95HD {cell(values, 'hausdorff95_mm')}, seeds {seeds}",
        "prediction_s": time.monotonic() - begin,
        "machine": describe(device, ("torch",)),
        "plain": {name: score for name, score, _ in scores},
        "largest": largest,
    }
