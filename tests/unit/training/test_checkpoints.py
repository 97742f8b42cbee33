"""Checkpoints: one training at a time, of the same settings, never replaced unasked; each key is needed."""

from __future__ import annotations

import json

import pytest
import torch

from sdm.cli import main
from sdm.deepsdf import DeepSDF
from sdm.deepsdf.train import checkpoint as deepsdf
from sdm.errors import FormatError, GridError
from sdm.segmentation import Settings, TrainedModel, load_model, load_settings, save_model
from sdm.surrogate import SDMNN, load_surrogate, save_weights
from sdm.training.checkpoints import check_settings, fitting_states, refuse_unfinished, training_folder

SETTINGS = Settings(patch=(16, 16, 16), filters=2, architecture="unet")


def test_a_folder_is_made_and_no_two_trainings_share_it(tmp_path):
    folder = tmp_path / "a" / "b"
    with training_folder(folder):
        assert folder.is_dir()
        with pytest.raises(FormatError, match="is being written by another process"), training_folder(folder):
            pass
        # Another process of the same training.
        with training_folder(folder, lock=False):
            pass
    with training_folder(folder):
        pass


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with (
        pytest.raises(FormatError, match=r"the folder .*file/b cannot be made"),
        training_folder(tmp_path / "file" / "b"),
    ):
        pass


def test_an_unfinished_training_is_not_replaced(tmp_path):
    refuse_unfinished(tmp_path / "none")
    with pytest.raises(FormatError, match="keeps an unfinished training: --resume goes on with it; or remove it"):
        refuse_unfinished(tmp_path)


def test_a_checkpoint_of_other_settings(tmp_path):
    check_settings(SETTINGS.record(), SETTINGS, tmp_path)
    with pytest.raises(FormatError, match="is the checkpoint of a training with other settings"):
        check_settings({**SETTINGS.record(), "batch": 3}, SETTINGS, tmp_path)


def test_states_that_do_not_fit(tmp_path):
    net, other = torch.nn.Linear(2, 1), torch.nn.Linear(3, 1)
    for state in (other.state_dict(), {}, {"weight": 1, "bias": 2}):
        sentence = r"is nothing: what it keeps does not fit its settings$"
        with pytest.raises(FormatError, match=sentence), fitting_states(tmp_path, "is nothing"):
            net.load_state_dict(state)
    for error in (GridError("as it is"), torch.OutOfMemoryError("as it is")):
        with pytest.raises(type(error), match=r"^as it is$"), fitting_states(tmp_path, "is nothing"):
            raise error


def refused(capsys, *words):
    assert main([str(word) for word in words]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    return said


@pytest.mark.parametrize("key", ["format", "settings", "spacing", "weights"])
def test_a_segmentation_network_needs_each_key(tmp_path, key):
    path = tmp_path / "m.pt"
    save_model(TrainedModel(SETTINGS.network(), SETTINGS, (1.0, 1.0, 1.0)), path)
    whole = torch.load(path)
    assert set(whole) == {"format", "settings", "spacing", "weights"}
    for wrong in ({k: v for k, v in whole.items() if k != key}, {**whole, key: 3}, {**whole, key: {"a": "b"}}):
        torch.save(wrong, path)
        for read in (load_model, load_settings):
            with pytest.raises(FormatError, match=r"m\.pt (is|has) "):
                read(path)


@pytest.mark.parametrize("key", ["kind", "version", *deepsdf.MODEL_FIELDS])
def test_a_deepsdf_model_needs_each_key(tmp_path, key):
    whole = deepsdf.read_model(deepsdf.shipped()["cochlea"])
    assert set(whole) == {"kind", "version", *deepsdf.MODEL_FIELDS}
    path = tmp_path / "m.pt"
    for wrong in ({k: v for k, v in whole.items() if k != key}, {**whole, key: None}, {**whole, key: {"a": "b"}}):
        torch.save(wrong, path)
        with pytest.raises(FormatError, match=r"m\.pt (is|has) "):
            DeepSDF.load(path, "cpu")


@pytest.mark.parametrize("key", ["version", "model", "config", "grid", "parameters", "family"])
def test_a_surrogate_needs_each_key(tmp_path, key):
    path = tmp_path / "m.safetensors"
    save_weights(SDMNN(channels=2), path)
    beside = path.with_suffix(".json")
    whole = json.loads(beside.read_text())
    assert set(whole) == {"version", "model", "config", "grid", "parameters", "family"}
    for wrong in ({k: v for k, v in whole.items() if k != key}, {**whole, key: None}, {**whole, key: {"a": "b"}}):
        beside.write_text(json.dumps(wrong))
        with pytest.raises(FormatError, match=r"m\.(json|safetensors) (is not|holds) a surrogate"):
            load_surrogate(path)
    for wrong in ("3", "[1]", "null", "[" * 100_000):
        beside.write_text(wrong)
        with pytest.raises(FormatError, match=r"m\.safetensors is not a surrogate that sdm wrote"):
            load_surrogate(path)


def test_names_and_spheres_go_together(tmp_path):
    whole = deepsdf.read_model(deepsdf.shipped()["cochlea"])
    torch.save({**whole, "spheres": whole["spheres"][1:]}, tmp_path / "m.pt")
    with pytest.raises(FormatError, match="it has 500 names, 499 spheres"):
        DeepSDF.load(tmp_path / "m.pt", "cpu")


def test_commands_say_one_sentence_of_a_file_that_is_no_model(tmp_path, capsys):
    path = tmp_path / "m.pt"
    torch.save({"format": "sdm segmentation 1"}, path)
    said = refused(capsys, "segment", tmp_path / "image.nii.gz", "--model", path, "-o", tmp_path / "s")
    assert "m.pt is not a trained segmentation network: it has no 'settings'" in said


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_pickle_that_is_not_torch_s_is_one_sentence(tmp_path, protocol, recwarn):
    import pickle

    path = tmp_path / "pickle.pt"
    path.write_bytes(pickle.dumps({"a": 1}, protocol=protocol))
    with pytest.raises(FormatError, match=r"pickle\.pt is no DeepSDF model, or it is damaged"):
        DeepSDF.load(path, "cpu")
    assert not recwarn
