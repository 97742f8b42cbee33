"""Files of torch on a full disk."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch

from sdm.deepsdf.train import checkpoint
from sdm.errors import FormatError
from sdm.io.files.torch_file import load_torch, save_torch
from sdm.segmentation.train import training as segmentation
from sdm.segmentation.train.settings import Settings

LIMIT = 200_000


@contextmanager
def small_files() -> Iterator[None]:
    """Files may not grow beyond `LIMIT` bytes: for who writes them that is what a full disk is."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    save_torch({"a": torch.arange(3)}, tmp_path / "a.pt")
    assert load_torch(tmp_path / "a.pt", "is nothing")["a"].tolist() == [0, 1, 2]
    assert [path.name for path in tmp_path.iterdir()] == ["a.pt"]


# Full at once, at the end of the data, and in the table that comes last.
@pytest.mark.parametrize("count", [1_000_000, LIMIT // 4 - 200, LIMIT // 4 - 350])
def test_a_full_disk_is_one_sentence_and_keeps_the_old_file(tmp_path: Path, count: int) -> None:
    path = tmp_path / "a.pt"
    path.write_bytes(b"old")
    with small_files(), pytest.raises(FormatError, match=r"a\.pt cannot be written: File too large"):
        save_torch({"a": torch.zeros(count), "b": torch.zeros(100), "c": torch.zeros(100)}, path)
    assert path.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.pt"]


def test_other_errors_are_what_they_are(tmp_path: Path) -> None:
    class Strange:
        def __reduce__(self) -> str:
            raise RuntimeError("strange")

    with pytest.raises(RuntimeError, match="strange"):
        save_torch(Strange(), tmp_path / "a.pt")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", [b"", b"junk", b"text", b"PK\x03\x04 no archive", b"\x80\x02c", b"hello\n" * 99])
@pytest.mark.parametrize("mmap", [False, True])
def test_whatever_bytes_are_no_file_of_torch_s(tmp_path: Path, content: bytes, mmap: bool) -> None:
    path = tmp_path / "a.pt"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"a\.pt is nothing$"):
        load_torch(path, "is nothing", mmap=mmap)


@pytest.mark.parametrize("content", [torch.zeros(3), [1, 2], "words"])
def test_what_is_no_dictionary(tmp_path: Path, content: object) -> None:
    torch.save(content, tmp_path / "a.pt")
    with pytest.raises(FormatError, match=r"a\.pt is nothing$"):
        load_torch(tmp_path / "a.pt", "is nothing")


def test_checkpoints_too(tmp_path: Path) -> None:
    large = {"state": torch.zeros(1_000_000)}
    with small_files(), pytest.raises(FormatError, match="File too large"):
        checkpoint.write_both(large, {}, tmp_path / "checkpoint")
    settings = Settings(patch=(16, 16, 16))
    model = settings.network()
    optimizer = torch.optim.SGD(model.parameters(), 1.0)
    training = segmentation.Training(model)
    with small_files(), pytest.raises(FormatError, match=r"c\.pt cannot be written: File too large"):
        segmentation._save(tmp_path / "c.pt", training, optimizer, settings, torch.device("cpu"))
    assert list(tmp_path.iterdir()) == []
