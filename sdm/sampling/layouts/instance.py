"""Names of the meshes of a folder in a dataset: a class and an instance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

# Of meshes that lie in no folder.
ONE_CLASS = "all"


@dataclass(frozen=True)
class Instance:
    """A mesh in a dataset.

    Args:
        path: Its place below the folder, without its ending, with "/": what its random numbers depend on.
        category: The folders above the last one that tells meshes apart, joined by "_".
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
    return [
        Instance(place.as_posix(), "_".join(own[:-1]) or ONE_CLASS, own[-1])
        for place, own in zip(places, parts, strict=True)
    ]


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
