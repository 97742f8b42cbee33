"""Streams and datasets whose maps are signed by another method than winding numbers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.cli import main
from sdm.dataset import SDMDataset, generate
from sdm.errors import FormatError, SDMError
from sdm.shapes import MeshFolder


@pytest.fixture
def family():
    ball = trimesh.creation.icosphere(2)
    return MeshFolder([sdm.TriangleMesh(ball.vertices, ball.faces, "ball")])


def test_streams_sign_as_they_are_told(family):
    grid = family.grid(14)
    streams = {sign: sdm.SDMStream(family, grid, 3, device="cpu", sign=sign) for sign in ("winding", "flood", "none")}
    maps = {sign: next(iter(stream)).sdm for sign, stream in streams.items()}
    assert torch.equal(maps["flood"], maps["winding"])
    assert torch.equal(maps["none"], maps["winding"].abs())
    assert (maps["winding"] < 0).any()
    with pytest.raises(SDMError, match="sign is winding, but here it is none"):
        streams["none"].load_state_dict(streams["winding"].state_dict())
    state = streams["winding"].state_dict()
    del state["recipe"]["sign"], state["recipe"]["hole_size"]
    streams["winding"].load_state_dict(state)
    with pytest.raises(SDMError, match="sign is winding, but here it is flood"):
        streams["flood"].load_state_dict(state)
    assert streams["flood"].validation(2).name == streams["winding"].validation(2).name


def test_datasets_hold_what_the_stream_yields(family, tmp_path):
    grid = family.grid(12)
    made = {"sign": "flood", "hole_size": 0.3}
    generate(family, grid, 3, tmp_path / "a.zarr", device="cpu", **made)
    found = SDMDataset(tmp_path / "a.zarr")
    expected = sdm.SDMStream(family, grid, 3, device="cpu", **made).sample([0, 1, 2]).sdm
    assert all(torch.equal(torch.as_tensor(found[i].sdm), expected[i]) for i in range(3))
    assert (found.manifest["recipe"]["sign"], found.manifest["recipe"]["hole_size"]) == ("flood", 0.3)
    for other in ({}, {"sign": "flood"}, {"sign": "none"}):
        with pytest.raises(FormatError, match=r"(sign|hole_size) .* was requested"):
            generate(family, grid, 3, tmp_path / "a.zarr", device="cpu", resume=True, **other)


def test_the_command_takes_a_sign(tmp_path, capsys):
    words = ["--count", "2", "--resolution", "10", "--triangles", "300", "--device", "cpu", "-o"]
    assert main(["generate", "ellipsoid", *words, str(tmp_path / "a.zarr"), "--sign", "none"]) == 0
    values = np.asarray(SDMDataset(tmp_path / "a.zarr")[0].sdm)
    assert (values >= 0).all()
    assert main(["generate", "ellipsoid", *words, str(tmp_path / "b.zarr"), "--hole-size", "0.1"]) == 2
    assert "hole_size is the width of gaps" in capsys.readouterr().err
