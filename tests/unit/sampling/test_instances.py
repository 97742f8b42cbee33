"""Names of a folder's meshes in a dataset: no two meshes have one, and so no two have one file."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path, PurePosixPath

import numpy as np
import pytest
import torch

from sdm.errors import MeshError
from sdm.sampling.layouts.by_name import layout_called
from sdm.sampling.layouts.instance import Instance, instances_of
from sdm.sampling.sample import PointSamples

PLACES = [
    # Folders whose names are joined, and those that are called like what they are joined to.
    ("a/b/x", "a/b/y", "a_b/x", "a_b/z"),
    # What lies in no folder, beside a folder called like its class.
    ("x", "all/x", "all/y"),
    ("a/b_c/x", "a_b/c/x", "a_b_c/x", "a_b_c_/x", "a/b/c/x", "q"),
]


def named(places: tuple[str, ...]) -> list[Instance]:
    return instances_of([PurePosixPath(place) for place in places])


@pytest.mark.parametrize("places", PLACES)
def test_no_two_have_one_name(places):
    found = named(places)
    assert [own.path for own in found] == list(places)
    assert len({(own.category, own.name) for own in found}) == len(places)
    # A class is one folder.
    folders = {own.category: PurePosixPath(own.path).parent for own in found}
    assert all(folders[own.category] == PurePosixPath(own.path).parent for own in found)


def test_names_that_are_told_apart_stay():
    found = named(("02691156/aa/models/m", "03001627/bb/models/m"))
    assert [(own.category, own.name) for own in found] == [("02691156", "aa"), ("03001627", "bb")]
    assert [own.category for own in named(("a/b/x", "a/c/y", "z"))] == ["a_b", "a_c", "all"]


def samples(number: int) -> PointSamples:
    return PointSamples(torch.full((2, 3), float(number)), torch.zeros(2), torch.zeros(2, dtype=torch.int64), None)


def test_tar_keys_are_told_apart(tmp_path):
    """A key ends at its first dot, so that dots become something else, which other names may have."""
    places = ("a/m.1", "a/m_1", "a/m", "a.b/m", "a_b/m")
    layout = layout_called("webdataset", "set")
    layout.begin(tmp_path, named(places), 2)
    for number in range(len(places)):
        layout.write(number, samples(number))
    found: dict[str, dict[str, bytes]] = {}
    with tarfile.open(tmp_path / "samples-000000.tar") as tar:
        for member in tar:
            key, _, ending = member.name.partition(".")
            file = tar.extractfile(member)
            assert file is not None
            assert ending not in found.setdefault(key, {})
            found[key][ending] = file.read()
    assert [json.loads(own["json"])["path"] for own in found.values()] == list(places)
    points = [np.load(io.BytesIO(own["samples.npz"]))["points"][0, 0] for own in found.values()]
    assert points == [0, 1, 2, 3, 4]


def test_failed_meshes_of_a_tar_file_are_not_there_later(tmp_path: Path):
    """A tar file that was finished without a mesh is no reason to say that its samples are there."""
    places = ("a/good", "a/bad")
    first = layout_called("webdataset", "set")
    first.begin(tmp_path, named(places), 2)
    first.write(0, samples(0))
    first.failed(1)
    later = layout_called("webdataset", "set")
    later.begin(tmp_path, named(places), 2)
    assert later.is_done(0)
    with pytest.raises(MeshError, match=r"a/bad could not be used when .*samples-000000.tar was written without it"):
        later.is_done(1)
    later.failed(1)
    (tmp_path / "samples-000000.tar").unlink()
    third = layout_called("webdataset", "set")
    third.begin(tmp_path, named(places), 2)
    assert not third.is_done(1)
    for number in range(2):
        third.write(number, samples(number))
    last = layout_called("webdataset", "set")
    last.begin(tmp_path, named(places), 2)
    assert last.is_done(1)
