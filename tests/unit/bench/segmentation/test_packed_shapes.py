"""Packed labels without images, and a row with synthetic cases."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from sdm.bench.segmentation import ma
from sdm.bench.segmentation.pack import pack, packed_cases, shapes_of, unpack
from sdm.segmentation.data.downsample import coarse_image
from tests.helpers.segmentation_cases import volume, write_hdf5


@pytest.fixture
def packed(tmp_path):
    for part, seeds in (("train", (0, 1)), ("val", (2,))):
        for seed in seeds:
            image, label = volume(seed)
            write_hdf5(tmp_path / "la" / part / f"case{seed}.h5", np.rint(20 * image).clip(-100, 100) / 7, label)
    (tmp_path / "la" / "labels").mkdir()
    label = volume(5)[1]
    np.savez(tmp_path / "la" / "labels" / "other.npz", bits=np.packbits(label), shape=np.array(label.shape))
    pack(tmp_path / "la", tmp_path / "la.npz")
    return tmp_path / "la.npz"


def test_labels_without_images_come_back(packed, tmp_path):
    wanted = torch.from_numpy(volume(5)[1] != 0)
    unpack(packed, tmp_path / "again")
    for place in (packed, packed.parent / "la", tmp_path / "again"):
        found = shapes_of(place)
        assert list(found) == ["other"]
        assert torch.equal(found["other"], wanted)
    cases = packed_cases(packed, "train")
    assert [case.name for case in cases] == ["case0", "case1"]
    assert cases[1].label is not None
    assert torch.equal(cases[1].label, torch.from_numpy(volume(1)[1] != 0))


def test_a_row_with_synthetic_cases_is_trained(packed, tmp_path, monkeypatch):
    logs = tmp_path / "logs.jsonl"
    words = f"ma run --data {packed} --logs {logs}/some --work {tmp_path / 'work'} --methods head-sdf-l2 --seeds 0 1"
    words += " --steps 1 --patch 16 16 16 --filters 2 --synthetic 1 --gpus 0"
    monkeypatch.setattr("sys.argv", words.split())
    ma.main()
    lines = [json.loads(line) for line in logs.read_text().splitlines()]
    assert [line["job"]["settings"]["synthetic"] for line in lines] == [1.0, 1.0]
    assert list(lines[0]["largest"]) == ["case2"]


def test_means_of_cubes_are_what_a_coarser_network_sees(packed, tmp_path):
    pack(packed.parent / "la", tmp_path / "la3.npz", coarsen=3)
    for fine, coarse in zip(packed_cases(packed, "train"), packed_cases(tmp_path / "la3.npz", "train"), strict=True):
        assert torch.equal(coarse_image(coarse.image, 3), coarse_image(fine.image, 3).round())
        assert torch.equal(coarse.label, fine.label)
