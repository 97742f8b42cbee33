"""Streams in a DataLoader: workers on the CPU keep the order; forked ones on CUDA are refused with a sentence."""

from __future__ import annotations

import itertools
import os
import pickle

import pytest
import torch
from torch.utils.data import DataLoader

from sdm.errors import DeviceError
from sdm.shapes import Cochlea
from sdm.stream import Batch, SDMStream

FAMILY = Cochlea(600)


def stream(**options):
    return SDMStream(FAMILY, FAMILY.grid(10), 2, device="cpu", **options)


def numbers(source, steps=5):
    return [batch.index.tolist() for batch in itertools.islice(source, steps)]


def test_loader_without_workers_passes_batches_on():
    expected = list(itertools.islice(stream(), 3))
    for found, wanted in zip(DataLoader(stream(), batch_size=None), expected, strict=False):
        assert isinstance(found, Batch)
        assert torch.equal(found.sdm, wanted.sdm)


def test_workers_share_out_the_steps_in_order():
    loader = DataLoader(stream(stop=14), batch_size=None, num_workers=2, multiprocessing_context="fork")
    assert numbers(loader, 99) == numbers(stream(stop=14), 99)


def test_workers_have_the_rank_of_a_process_group_made_after_the_stream(monkeypatch):
    source, other = stream(), stream()
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_rank", lambda: 1)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 2)
    loader = DataLoader(source, batch_size=None, num_workers=1, multiprocessing_context="fork")
    assert numbers(loader, 2) == [[2, 3], [6, 7]]
    # As a spawned worker gets it, which is not in the process group.
    pickled = pickle.dumps(other)
    monkeypatch.undo()

    class Info:
        id, num_workers = 0, 1

    monkeypatch.setattr("sdm.stream.stream.get_worker_info", Info)
    assert numbers(pickle.loads(pickled), 2) == [[2, 3], [6, 7]]


def test_a_worker_goes_on_with_its_own_steps(monkeypatch):
    class Info:
        id, num_workers = 1, 3

    monkeypatch.setattr("sdm.stream.stream.get_worker_info", Info)
    source = stream()
    assert numbers(source, 2) == [[2, 3], [8, 9]]
    state = source.state_dict()
    assert numbers(source, 1) == [[14, 15]]
    resumed = stream()
    resumed.load_state_dict(state)
    assert numbers(resumed, 1) == [[14, 15]]


@pytest.mark.filterwarnings("ignore:'set_vital' is deprecated")
def test_torchdata_resumes_it():
    stateful = pytest.importorskip("torchdata.stateful_dataloader", reason="needs torchdata")
    loader = stateful.StatefulDataLoader(stream(), batch_size=None)
    iterator = iter(loader)
    next(iterator)
    state = loader.state_dict()
    expected = next(iterator)
    again = stateful.StatefulDataLoader(stream(), batch_size=None)
    again.load_state_dict(state)
    assert torch.equal(next(iter(again)).sdm, expected.sdm)


def test_a_fork_on_cuda_is_told_what_to_do():
    source = stream()
    # As in a child process of one that made the stream on a GPU.
    source._maker.device = torch.device("cuda", 0)
    source._process = os.getpid() + 1
    for use in (lambda: next(iter(source)), lambda: source.sample(0), lambda: source.validation(1)):
        with pytest.raises(DeviceError, match="num_workers=0"):
            use()


def test_a_stream_made_in_a_fork_is_told_too(monkeypatch):
    monkeypatch.setattr(torch.cuda, "_is_in_bad_fork", lambda: True)
    for device in (None, "cuda"):
        with pytest.raises(DeviceError, match="num_workers=0"):
            SDMStream(FAMILY, FAMILY.grid(4), device=device)
    assert SDMStream(FAMILY, FAMILY.grid(4), 1, device="cpu").sample(0).sdm.shape == (1, 1, 4, 4, 4)
