"""Ensembles of Ma's rows: the mean over a method's seeds, of networks that their trainings kept.

A training keeps its network as METHOD-SEED.pt; the scores of their mean are METHOD-ensemble.json beside the logs.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from bench._machine import describe
from bench._segmentation_jobs import Job, read_ensembles, read_logs
from bench._segmentation_trials import Logs, by_case, means
from sdm.segmentation import METHODS, Case, Settings, cell, check_cases, load_model, load_settings, read_cases
from sdm.segmentation import validate_ensemble as validate

# Seconds of an ensemble of three seeds where processes share a GPU: there a training's own prediction took 1 to 7.
ENSEMBLE_S = 15.0


def kept_file(keep: Path, job: Job) -> Path:
    """Where a training keeps its network."""
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


def ensemble_jobs(listed: Sequence[Job], keep: Path, logs: Path, *, complete: bool = False) -> list[Job]:
    """An ensemble for each method of which two or more trainings, if `complete` all that are listed, kept a network.

    Those whose log has these seeds, or some that are not kept any more, are left out: they are done.
    """
    known = {log["job"]["name"]: set(log["job"]["seeds"]) for log in read_ensembles(logs)} if logs.is_dir() else {}
    found = []
    for own in _by_method(listed).values():
        kept = [job for job in own if kept_file(keep, job).is_file()]
        if len(kept) < (max(2, len(own)) if complete else 2):
            continue
        job = as_ensemble(kept, keep)
        if set(job["seeds"]) > known.get(job["name"], set()):
            found.append(job)
    return found


def too_few(listed: Sequence[Job], keep: Path) -> list[str]:
    """Methods of which fewer than two networks are kept."""
    methods = _by_method(listed).items()
    return [name for name, own in methods if sum(kept_file(keep, job).is_file() for job in own) < 2]


def _by_method(listed: Sequence[Job]) -> dict[str, list[Job]]:
    found: dict[str, list[Job]] = {}
    for job in listed:
        found.setdefault(job["settings"]["method"], []).append(job)
    return found


def ensemble_after(job: Job, *, listed: Sequence[Job], keep: Path, logs: Path) -> Job | None:
    """The ensemble of a method, once its last training is done."""
    own = [other for other in listed if other["settings"]["method"] == job["settings"]["method"]]
    return next(iter(ensemble_jobs(own, keep, logs, complete=True)), None)


def cases_of(job: Job, part: str, kept: dict[str, Any]) -> list[Case]:
    """The cases to train or to validate on, read once in a process."""
    if part not in kept:
        cases = read_cases(Path(job["data"]), part)[: job["cases"]]
        check_cases(cases)
        kept[part] = cases
    return kept[part]


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
    seeds = ", ".join(map(str, job["seeds"]))
    return {
        "summary": f"Dice {cell(values, 'dice')}, 95HD {cell(values, 'hausdorff95_mm')}, seeds {seeds}",
        "prediction_s": time.monotonic() - begin,
        "machine": describe(device, ("torch",)),
        "plain": {name: score for name, score, _ in scores},
        "largest": largest,
    }


def ensembles_tables(folders: Mapping[str, Path], moved: str | None = None) -> str:
    """A row for each ensemble beside the mean over its seeds' trainings, then its cases; empty if there are none.

    An empty prediction counts as a distance of `FAILED`. A mean is missing where the log of one of its trainings is. If
    there is a case `moved`, the means without it follow.
    """
    lines = ["| logs | method (seeds) | Dice [%] | mean of seeds | 95HD [voxels] | mean of seeds |"]
    lines.append("|---|---|---|---|---|---|")
    if moved is not None:
        lines = [lines[0] + f" Dice, 95HD without {moved[:4]} | mean of seeds |", lines[1] + "---|---|"]
    found = [(name, log, _trainings(log, folder)) for name, folder in folders.items() for log in _ordered(folder)]
    for name, log, own in found:
        both = zip(means([log]), means(own) if own else (None, None), strict=True)
        cells = [text for pair in both for text in ("-" if value is None else f"{value:.2f}" for value in pair)]
        if moved is not None:
            cells += ["{:.2f}, {:.2f}".format(*means(logs, moved)) if logs else "-" for logs in ([log], own)]
        lines.append(f"| {name} | {_called(log)} | {' | '.join(cells)} |")
    if not found:
        return ""
    cases = list(by_case([found[0][1]]))
    lines += ["", "95HD of an ensemble by case, in brackets the mean of its seeds:", ""]
    lines += [
        f"| logs | method (seeds) | {' | '.join(case[:4] for case in cases)} |",
        "|---|---|" + "---|" * len(cases),
    ]
    for name, log, own in found:
        one, several = by_case([log]), by_case(own)
        cells = [_distances(one.get(case, [])) + f" ({_distances(several.get(case, []))})" for case in cases]
        lines.append(f"| {name} | {_called(log)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _ordered(folder: Path) -> Logs:
    order = list(METHODS)
    found = read_ensembles(folder) if folder.is_dir() else []
    return sorted(found, key=lambda log: order.index(log["job"]["settings"]["method"]))


def _trainings(log: Mapping[str, Any], folder: Path) -> Logs:
    """Those of an ensemble's seeds; none unless all are there."""
    method, seeds = log["job"]["settings"]["method"], log["job"]["seeds"]
    names = {f"{method}-{seed}" for seed in seeds}
    own = [one for one in read_logs(folder) if one["job"]["name"] in names]
    return own if len(own) == len(seeds) else []


def _called(log: Mapping[str, Any]) -> str:
    return f"{log['job']['settings']['method']} ({', '.join(map(str, log['job']['seeds']))})"


def _distances(values: Sequence[tuple[float, float]]) -> str:
    return f"{statistics.fmean(distance for _, distance in values):.1f}" if values else "-"
