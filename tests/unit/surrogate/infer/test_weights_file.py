"""Weights as files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from sdm.errors import FormatError
from sdm.surrogate import SDMNN, SDMNNPlus, load_weights, save_weights

THETA = torch.tensor([[3.7, 0.45, 0.146, 0.6]])


def test_a_map_survives_the_file_within_its_rounding(tmp_path):
    torch.manual_seed(0)
    model = SDMNNPlus(modes=40, channels=4).eval()
    save_weights(model, tmp_path / "a.safetensors", errors={"mae_mm": 1.0})
    again, facts = load_weights(tmp_path / "a.safetensors")
    assert facts["errors"] == {"mae_mm": 1.0}
    assert facts["config"]["modes"] == 40
    with torch.no_grad():
        wanted, found = model(THETA), again(THETA)
    assert 0 < (found - wanted).abs().mean() < 0.01 * wanted.abs().mean()
    # The first rows of the modes, which weigh most, are finer than the others.
    assert {v.dtype for k, v in load_file(tmp_path / "a.safetensors").items() if k.startswith("modes.")} == {
        torch.float16,
        torch.float32,
        torch.int8,
    }


def test_the_default_plus_is_at_most_8_mb(tmp_path):
    save_weights(SDMNNPlus(), tmp_path / "a.safetensors")
    assert (tmp_path / "a.safetensors").stat().st_size <= 8e6


@pytest.mark.parametrize("path", ["", ".", "/"])
def test_paths_without_a_name(path):
    with pytest.raises(FormatError, match="is a folder; give a file"):
        load_weights(Path(path))


def test_what_is_not_a_surrogate_is_refused(tmp_path):
    with pytest.raises(FormatError, match="cannot be read"):
        load_weights(tmp_path / "none.safetensors")
    path = tmp_path / "a.safetensors"
    save_weights(SDMNN(channels=2), path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FormatError, match="damaged"):
        load_weights(path)
    path.write_bytes(whole)
    config = json.loads(path.with_suffix(".json").read_text())
    config["grid"]["shape"] = [8, 8, 8]
    path.with_suffix(".json").write_text(json.dumps(config))
    with pytest.raises(FormatError, match="another grid"):
        load_weights(path)
    path.with_suffix(".json").write_bytes(b"\xff\xfe{}")
    with pytest.raises(FormatError, match="is not a surrogate that sdm wrote"):
        load_weights(path)
