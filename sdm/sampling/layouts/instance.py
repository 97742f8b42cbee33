"""Names of the meshes of a folder in a dataset: a class and an instance."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath

# Of meshes that lie in no folder.
ONE_CLASS = "all"


@dataclass(frozen=True)
class Instance:
    """A mesh in a dataset.

    Args:
        path: Its place below the folder, without its ending, with "/": what its random numbers depend on.
        category: The folders above the last one that tells meshes apart, joined by "_"; each class is one folder.
        name: That last one.
    """

    path: str
    category: str
    name: str


def instances_of(places: Sequence[PurePath]) -> list[Instance]:
    """Names for meshes at places below a folder, as `sdm.cli.common.output_files.places_in` gives them.

    Names of files and folders at the end that all have alike say nothing and are left out: of
    `02691156/10155655850468db78d106ce0a280f87/models/model_normalized` what is left is the class 02691156, and the
    instance 10155655850468db78d106ce0a280f87.
    """
    parts = [place.parts for place in places]
    while len({own[-1] for own in parts}) == 1 and len(parts) > 1 and all(len(own) > 1 for own in parts):
        parts = [own[:-1] for own in parts]
    categories = _distinct(own[:-1] for own in parts)
    return [
        Instance(place.as_posix(), category, own[-1])
        for place, own, category in zip(places, parts, categories, strict=True)
    ]


def _distinct(folders: Iterable[tuple[str, ...]]) -> list[str]:
    """The class of each folder: other folders whose names come to be the same get "_" at the end."""
    known: dict[tuple[str, ...], str] = {}
    taken: set[str] = set()
    found = []
    for folder in folders:
        if folder not in known:
            known[folder] = free_name("_".join(folder) or ONE_CLASS, taken)
        found.append(known[folder])
    return found


def free_name(name: str, taken: set[str]) -> str:
    """A name, with "_" at its end as often as it takes to be no other's; it is taken then."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def lists_of(
    instances: Sequence[Instance], done: Sequence[bool], parts: dict[str, list[int]]
) -> dict[str, dict[str, list[str]]]:
    """Lists of the instances that are there: part -> class -> names, of "all" and of each part of a split.

    A class of which a part has nothing has an empty list there.
    """
    classes = list(dict.fromkeys(own.category for own, there in zip(instances, done, strict=True) if there))
    found: dict[str, dict[str, list[str]]] = {}
    for part, numbers in {"all": range(len(instances)), **parts}.items():
        lists = found[part] = {category: [] for category in classes}
        for number in numbers:
            if done[number]:
                lists[instances[number].category].append(instances[number].name)
    return found
