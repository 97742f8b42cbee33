from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import FormatError, GridError
from sdm.io import FORMATS, check_target, grid_like, load, save, write_streamed

GRID = Grid((0, 0, 0), (1, 1, 1), (6, 5, 4))
FIELD = SDM(torch.arange(120, dtype=torch.float32).reshape(6, 5, 4), GRID, 0)
ENDINGS = list(FORMATS)


def one_sentence(error: pytest.ExceptionInfo[Exception], *words: str) -> None:
    text = str(error.value)
    assert "\n" not in text
    for word in words:
        assert word in text


@pytest.mark.parametrize("name", ["map.tif", "map", "map.nii.bz2", ".npz", "npz"])
@pytest.mark.parametrize("call", [load, grid_like, lambda path: save(FIELD, path)])
def test_an_ending_that_is_not_known(call, name, tmp_path):
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(FormatError) as error:
        call(tmp_path / name)
    one_sentence(error, name, ".nii.gz", ".zarr")


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("call", [load, grid_like])
def test_no_file(call, ending, tmp_path):
    with pytest.raises(FormatError, match="there is no file"):
        call(tmp_path / f"map.{ending}")


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("content", [b"", b"hello", bytes(1000), b"NRRD0004\nfoo\n", b"PK\x03\x04hello"])
@pytest.mark.parametrize("call", [load, grid_like])
def test_files_that_are_something_else(call, content, ending, tmp_path):
    path = tmp_path / f"map.{ending}"
    path.write_bytes(content)
    with pytest.raises(FormatError) as error:
        call(path)
    one_sentence(error, path.name)


@pytest.mark.parametrize("ending", [ending for ending in ENDINGS if ending != "zarr"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.99])
def test_files_that_are_cut_off(ending, share, tmp_path):
    path = tmp_path / f"map.{ending}"
    big = Grid((0, 0, 0), (1, 1, 1), (20, 20, 20))
    save(SDM(torch.from_numpy(np.random.default_rng(0).normal(size=big.shape).astype(np.float32)), big), path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(FormatError) as error:
        load(path)
    one_sentence(error, path.name)


def test_a_zarr_that_lost_its_parts(tmp_path):
    path = tmp_path / "map.zarr"
    save(FIELD, path)
    (chunk,) = (file for file in path.rglob("*") if file.is_file() and file.name != "zarr.json")
    chunk.write_bytes(b"junk")
    with pytest.raises(FormatError, match=r"map\.zarr"):
        load(path)
    chunk.unlink()
    with pytest.raises(FormatError, match=r"map\.zarr has lost 1 of its 1 chunks"):
        load(path)
    (path / "zarr.json").unlink()
    with pytest.raises(FormatError, match=r"map\.zarr"):
        load(path)


@pytest.mark.parametrize("ending", ["nii.gz", "zarr"])
def test_one_flipped_bit_is_found(ending, tmp_path):
    path = tmp_path / f"map.{ending}"
    noise = np.random.default_rng(0).normal(size=(20, 20, 20)).astype(np.float32)
    save(SDM(torch.from_numpy(noise), Grid((0, 0, 0), (1, 1, 1), noise.shape)), path)
    (file,) = [path] if path.is_file() else [f for f in path.rglob("*") if f.is_file() and f.name != "zarr.json"]
    whole = file.read_bytes()
    for share in (0.1, 0.3, 0.5, 0.7, 0.9):
        data = bytearray(whole)
        data[int(share * len(data))] ^= 1
        file.write_bytes(data)
        with pytest.raises(FormatError) as error:
            load(path)
        one_sentence(error, path.name)


def test_a_zarr_without_checksums_is_still_read(tmp_path):
    import zarr

    path = tmp_path / "map.zarr"
    save(FIELD, path)
    kept = dict(zarr.open_array(path, mode="r").attrs)
    array = zarr.create_array(store=path, shape=(6, 5, 4), chunks=(6, 5, 4), dtype="float32", overwrite=True)
    array[:] = FIELD.numpy()
    array.attrs.update(kept)
    assert torch.equal(load(path).values, FIELD.values)


@pytest.mark.parametrize("ending", ["npz", "zarr"])
def test_arrays_of_other_software(ending, tmp_path):
    import zarr

    path = tmp_path / f"map.{ending}"
    if ending == "npz":
        np.savez(path, values=np.zeros(3))
    else:
        zarr.create_array(store=path, shape=(3,), dtype="float32")
    with pytest.raises(FormatError, match="not written by sdm"):
        load(path)


def test_a_zarr_group(tmp_path):
    import zarr

    zarr.create_group(store=tmp_path / "map.zarr")
    with pytest.raises(FormatError, match="group"):
        load(tmp_path / "map.zarr")


def test_a_pickle_is_never_opened(tmp_path):
    class Trap:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "sprung"),))

    np.savez(tmp_path / "map.npz", values=np.array([Trap()], dtype=object), version=1)
    with pytest.raises(FormatError):
        load(tmp_path / "map.npz")
    assert not (tmp_path / "sprung").exists()


def test_a_newer_version(tmp_path, monkeypatch):
    from sdm.io.maps import record

    monkeypatch.setattr(record, "VERSION", 2)
    for ending in ("npz", "nii", "nrrd", "zarr"):
        save(FIELD, tmp_path / f"map.{ending}")
    monkeypatch.undo()
    for ending in ("npz", "nii", "nrrd", "zarr"):
        with pytest.raises(FormatError, match="newer version"):
            load(tmp_path / f"map.{ending}")


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_folder_that_is_not_there(ending, tmp_path):
    with pytest.raises(FormatError) as error:
        save(FIELD, tmp_path / "nowhere" / f"map.{ending}")
    one_sentence(error, "nowhere is not there")


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_file_in_place_of_the_folder(ending, tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(FormatError) as error:
        save(FIELD, tmp_path / "file" / f"map.{ending}")
    one_sentence(error, "is not a folder")
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs /proc, where nobody may make files")
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_folder_that_takes_no_files(ending):
    with pytest.raises(FormatError) as error:
        save(FIELD, Path("/proc") / f"map.{ending}")
    one_sentence(error, "/proc does not take new files")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_folder_without_permission(ending, tmp_path):
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    with pytest.raises(FormatError, match="does not take new files"):
        save(FIELD, tmp_path / f"map.{ending}")


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_name_that_is_too_long(ending, tmp_path):
    with pytest.raises(FormatError) as error:
        save(FIELD, tmp_path / f"{'x' * 300}.{ending}")
    one_sentence(error, "cannot be written")


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_folder_of_that_name_is_never_replaced(ending, tmp_path):
    folder = tmp_path / f"map.{ending}"
    folder.mkdir()
    (folder / "thesis.txt").write_text("mine")
    with pytest.raises(FormatError, match="a folder of that name is there"):
        save(FIELD, folder)
    assert (folder / "thesis.txt").read_text() == "mine"
    assert list(tmp_path.iterdir()) == [folder]


def test_a_file_in_place_of_a_zarr_is_replaced(tmp_path):
    (tmp_path / "map.zarr").write_text("old")
    save(FIELD, tmp_path / "map.zarr")
    assert load(tmp_path / "map.zarr").grid == GRID


@pytest.mark.parametrize("kind", ["group", "array", "data set", "damaged"])
def test_a_zarr_that_is_no_map_is_never_replaced(kind, tmp_path):
    import zarr

    path = tmp_path / "map.zarr"
    if kind == "array":
        zarr.create_array(store=path, shape=(3,), dtype="float32", attributes={"mine": 1})
    else:
        # A data set of sdm generate keeps its manifest under the same key as a map.
        zarr.create_group(store=path, attributes={"sdm": {"version": 1}} if kind == "data set" else {})
    if kind == "damaged":
        (path / "zarr.json").write_text("{")
    before = (path / "zarr.json").read_text()
    for call in (check_target, lambda target: save(FIELD, target)):
        with pytest.raises(FormatError) as error:
            call(path)
        one_sentence(error, "map.zarr cannot be written: what is there is no map of sdm")
    assert (path / "zarr.json").read_text() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_zarr_map_is_replaced(tmp_path):
    save(SDM(FIELD.values + 1, GRID, 0), tmp_path / "map.zarr")
    save(FIELD, tmp_path / "map.zarr")
    assert torch.equal(load(tmp_path / "map.zarr").values, FIELD.values)


def test_a_target_is_checked_without_touching_it(tmp_path):
    (tmp_path / "map.npz").write_text("old")
    check_target(tmp_path / "map.npz")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]


class Never(MeshIndex):
    """An index that must not be asked."""

    def __init__(self) -> None:
        self.mesh: Any = None
        self.device = torch.device("cpu")


@pytest.mark.parametrize("ending", [ending for ending in ENDINGS if ending != "zarr"])
def test_a_map_larger_than_memory_is_refused_before_it_is_computed(ending, tmp_path):
    huge = Grid((0, 0, 0), (1, 1, 1), (100_000, 10_000, 10_000))
    with pytest.raises(GridError) as error:
        write_streamed(Never(), huge, tmp_path / f"map.{ending}")
    one_sentence(error, "needs", "GiB free", ".zarr")
    assert list(tmp_path.iterdir()) == []


def test_a_bad_place_is_refused_before_anything_is_computed(tmp_path):
    with pytest.raises(FormatError, match="nowhere is not there"):
        write_streamed(Never(), GRID, tmp_path / "nowhere" / "map.npz")
