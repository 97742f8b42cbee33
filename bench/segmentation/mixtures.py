"""Ensembles over networks of several protocols: those of one folder and, beside them, of the same method in others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sdm.bench.segmentation.ensembles import as_ensemble, by_method, kept_trainings
from sdm.bench.segmentation.log_file import Job, LogFile
from sdm.errors import SDMError
from sdm.segmentation import check_ensemble, load_model


def refuse_folders(keep: Path, beside: Sequence[Path], logs: LogFile, table: LogFile) -> None:
    """Networks must not count twice, and a mixture must not pass for a row of the table or of a protocol.

    Args:
        keep: Folder of networks.
        beside: Those whose networks stand beside these.
        logs: Where the mixtures' logs are to be.
        table: Where the table's are.
    """
    folders = [folder.resolve() for folder in (keep, *beside)]
    if len(set(folders)) < len(folders):
        raise SystemExit("a folder is named twice in --keep and --beside: its networks would count twice")
    if logs.resolve() == table.resolve() or logs.trainings():
        raise SystemExit(f"{logs} has the logs of trainings: choose a file of their own for mixtures with --logs")


def mixtures(
    like: Job, keep: Path, beside: Sequence[Path], methods: Sequence[str], seeds: Sequence[int] | None
) -> list[Job]:
    """For each method of which a folder keeps networks, their ensemble with those that each of the others keeps.

    A method that one of the others lacks, or whose networks have no mean, is named and left out. Networks of one folder
    may differ in the seed alone.

    Args:
        like: See `kept_trainings`, also for the methods and the seeds, of which None are all that are kept.
        keep: The folder that says which methods; its networks come first.
        beside: The others.
        methods: No others than these.
        seeds: No others than these.
    """
    own = by_method(kept_trainings(keep, like, methods, seeds))
    others = [(folder, by_method(kept_trainings(folder, like, list(own), seeds))) for folder in beside]
    found = []
    for method, first in own.items():
        if lacking := [str(folder) for folder, kept in others if method not in kept]:
            print(f"{method} is left out: no network of it is kept in {', '.join(lacking)}", flush=True)
            continue
        groups = [as_ensemble(first, keep), *(as_ensemble(kept[method], folder) for folder, kept in others)]
        try:
            check_ensemble(
                [load_model(Path(group["networks"][0])) for group in groups], [g["networks"][0] for g in groups]
            )
        except SDMError as wrong:
            print(f"{method} is left out: {wrong}", flush=True)
            continue
        found.append(_as_mixture(groups))
    return found


def _as_mixture(groups: Sequence[Job]) -> Job:
    """One ensemble of several; whichever network knows mirror images is shown its own."""
    return {
        **groups[0],
        "beside": [{"settings": group["settings"], "seeds": group["seeds"]} for group in groups[1:]],
        "networks": [path for group in groups for path in group["networks"]],
        "mirrors": "".join(axis for axis in "xyz" if any(axis in group["mirrors"] for group in groups)),
    }
