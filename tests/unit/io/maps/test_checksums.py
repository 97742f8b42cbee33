"""Maps that were damaged on the way: never other values or another grid without a word."""

from __future__ import annotations

import gzip
import json

import nibabel as nib
import nrrd
import numpy as np
import pytest
import torch

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError, SDMError
from sdm.io import FORMATS, grid_like, load, save
from sdm.io.maps.record import CHECKSUM, KEY, RECORD_CHECKSUM

SHAPE = (9, 8, 7)
GRID = Grid((-50.3, 20.1, 3), (0.7, 0.8, 1.9), SHAPE)
VALUES = torch.from_numpy(np.random.default_rng(0).normal(size=SHAPE).astype(np.float32))
FIELD = SDM(VALUES, GRID, 3)


@pytest.mark.parametrize("ending", ["nii", "nrrd"])
def test_a_flipped_bit_of_a_value_is_found(ending, tmp_path):
    path = tmp_path / f"map.{ending}"
    save(FIELD, path)
    whole = path.read_bytes()
    begin = len(whole) - VALUES.nbytes
    for place in np.random.default_rng(1).integers(begin, len(whole), 40):
        data = bytearray(whole)
        data[place] ^= 1 << int(place) % 8
        path.write_bytes(data)
        with pytest.raises(FormatError, match=r"is not what sdm wrote: it is damaged, or another program"):
            load(path)


@pytest.mark.parametrize("ending", ["nii", "nii.gz", "nrrd"])
def test_random_damage_is_found_or_harmless(ending, tmp_path):
    """Of a header alone damage may look as if another program had moved the map: then its values are right."""
    path = tmp_path / f"map.{ending}"
    save(FIELD, path)
    whole = path.read_bytes()
    rng = np.random.default_rng(2)
    moved = 0
    for _ in range(200):
        data = bytearray(whole)
        data[rng.integers(len(data))] = rng.integers(256)
        path.write_bytes(data)
        try:
            found = load(path)
        except SDMError:
            continue
        assert torch.equal(found.values, VALUES)
        moved += not np.allclose(found.grid.affine, GRID.affine, rtol=1e-6, atol=1e-5)
    # 16 numbers of the affine in 3,000 bytes.
    assert moved <= 12


@pytest.mark.parametrize("place", range(40, 48))
def test_a_damaged_shape_of_a_nifti(place, tmp_path):
    path = tmp_path / "map.nii"
    save(FIELD, path)
    data = bytearray(path.read_bytes())
    data[place] ^= 2
    path.write_bytes(data)
    with pytest.raises(SDMError):
        load(path)


def test_a_damaged_record_is_found(tmp_path):
    path = tmp_path / "map.nrrd"
    save(FIELD, path)
    data = path.read_bytes()
    path.write_bytes(data.replace(b'"ambiguous_voxels":3', b'"ambiguous_voxels":0'))
    with pytest.raises(FormatError, match="is not what sdm wrote"):
        load(path)


@pytest.mark.parametrize("ending", ["nii", "nrrd"])
@pytest.mark.parametrize("read", [load, grid_like])
def test_a_damaged_geometry_is_found(ending, read, tmp_path):
    """Else it would look as if another program had moved the image, and damaged values would go unseen beside it."""
    path = tmp_path / f"map.{ending}"
    save(FIELD, path)
    data = path.read_bytes()
    assert b'"spacing":[0.7,0.8,' in data
    path.write_bytes(data.replace(b'"spacing":[0.7,0.8,', b'"spacing":[0.7,0.4,')[:-1] + b"x")
    with pytest.raises(FormatError, match="is damaged"):
        read(path)


@pytest.mark.parametrize(
    ("ending", "name"),
    [
        ("nrrd", b"space origin"),
        ("nrrd", b"space directions"),
        ("mha", b"Offset"),
        ("mha", b"ElementSpacing"),
        ("mha", b"TransformMatrix"),
    ],
)
def test_a_header_that_lost_its_place_is_damaged(ending, name, tmp_path):
    """A letter of a key is enough, after which the image would lie at the origin, or have voxels of 1."""
    path = tmp_path / f"map.{ending}"
    save(FIELD, path)
    data = path.read_bytes()
    assert name in data
    path.write_bytes(data.replace(name, b"x" + name[1:]))
    with pytest.raises(FormatError, match="is damaged: its header has lost its"):
        load(path)
    with pytest.raises(FormatError, match="is damaged: its header has lost its"):
        grid_like(path)


@pytest.mark.parametrize("ending", ["nii", "nrrd", "mha", "mhd"])
def test_a_record_that_lost_its_own_checksum_is_damaged(ending, tmp_path):
    """A digit of its geometry alone would look like an image that was moved, whose values nobody compares."""
    path = tmp_path / f"map.{ending}"
    save(FIELD, path)
    data = path.read_bytes()
    assert data.count(b"record_crc32") == data.count(b"-50.3,") == 1
    path.write_bytes(data.replace(b"record_crc32", b"record_xrc32").replace(b"-50.3,", b"-50.4,"))
    with pytest.raises(FormatError, match="is damaged: its record is not what sdm wrote"):
        load(path)


@pytest.mark.parametrize("ending", ["nii", "nrrd"])
def test_a_record_that_is_no_json_is_found(ending, tmp_path):
    """Its checksum is lost with it, so the values may be anything."""
    path = tmp_path / f"map.{ending}"
    save(FIELD, path)
    path.write_bytes(path.read_bytes().replace(b'"direction":[[', b'"direction":[<'))
    with pytest.raises(FormatError, match="is damaged"):
        load(path)


@pytest.mark.parametrize("ending", ["nii", "nrrd"])
def test_maps_of_older_versions_have_no_checksum(ending, tmp_path, monkeypatch):
    from sdm.io.maps import nifti
    from sdm.io.maps import nrrd as nrrd_io

    for module in (nifti, nrrd_io):
        monkeypatch.setattr(module, "with_checksum", lambda kept, values: kept)
    save(FIELD, tmp_path / f"map.{ending}")
    again = load(tmp_path / f"map.{ending}")
    assert torch.equal(again.values, VALUES)
    assert (again.grid, again.ambiguous_voxels) == (GRID, 3)


def test_a_map_that_another_program_turns_is_read(tmp_path):
    """Its header keeps our record, but for another grid: what is there is then that program's."""
    save(SDM(VALUES, Grid((0, 0, 0), (1, 1, 1), SHAPE, np.diag([-1.0, -1.0, 1.0]))), tmp_path / "map.nii")
    image = nib.as_closest_canonical(nib.load(tmp_path / "map.nii"))  # pyright: ignore[reportPrivateImportUsage]
    nib.save(image, tmp_path / "turned.nii")  # pyright: ignore[reportPrivateImportUsage]
    assert torch.equal(load(tmp_path / "turned.nii").values, VALUES.flip(0, 1))


def test_the_checksum_is_where_others_see_it(tmp_path):
    save(FIELD, tmp_path / "map.nrrd")
    assert len(json.loads(nrrd.read_header(str(tmp_path / "map.nrrd"))[KEY])[CHECKSUM]) == 8


@pytest.mark.parametrize("kind", [np.complex64, np.complex128, "datetime64[s]"])
def test_an_npz_without_plain_numbers(kind, tmp_path):
    save(FIELD, tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as archive:
        arrays = dict(archive)
    arrays["values"] = arrays["values"].astype(np.int64).astype(kind)
    np.savez(tmp_path / "other.npz", **arrays)
    with pytest.raises(FormatError, match="plain numbers are needed"):
        load(tmp_path / "other.npz")


def test_an_npz_whose_values_are_another_shape_is_not_unpacked(tmp_path):
    save(FIELD, tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as archive:
        arrays = dict(archive)
    np.savez_compressed(tmp_path / "large.npz", **{**arrays, "values": np.zeros((400, 400, 10), np.float32)})
    with pytest.raises(FormatError, match=r"its values have the shape \(400, 400, 10\)"):
        load(tmp_path / "large.npz")
    np.savez_compressed(tmp_path / "beside.npz", **{**arrays, "origin": np.zeros(1_000_000)})
    with pytest.raises(FormatError, match="bytes beside its values"):
        load(tmp_path / "beside.npz")


@pytest.mark.parametrize("ending", list(FORMATS))
def test_a_grid_larger_than_memory_is_refused(ending, tmp_path, monkeypatch):
    from sdm.errors import GridError
    from sdm.io.maps import save_and_load as api

    save(FIELD, tmp_path / f"map.{ending}")

    def too_much(needed, device, what):
        raise GridError(f"{what} need {needed} bytes")

    monkeypatch.setattr(api, "require_memory", too_much)
    with pytest.raises(GridError, match="a map of 9 x 8 x 7 voxels need 2016 bytes"):
        load(tmp_path / f"map.{ending}")


def nrrd_with(path, encoding: str, data: bytes, more: str = "") -> None:
    head = "NRRD0004\ntype: float\ndimension: 3\nsizes: 10 10 10\nendian: little\nspacings: 1 1 1\n"
    path.write_bytes(f"{head}encoding: {encoding}\n{more}\n".encode() + data)


@pytest.mark.parametrize("encoding", ["gzip", "gz", "bzip2", "bz2"])
@pytest.mark.parametrize("skip", [0, 12])
def test_packed_nrrd(encoding, skip, tmp_path):
    import bz2

    values = np.arange(1000, dtype="<f4")
    data = (gzip.compress if encoding.startswith("g") else bz2.compress)(bytes(skip) + values.tobytes())
    nrrd_with(tmp_path / "a.nrrd", encoding, data, f"byte skip: {skip}\n" if skip else "")
    np.testing.assert_array_equal(load(tmp_path / "a.nrrd").numpy().ravel("F"), values)
    nrrd_with(tmp_path / "cut.nrrd", encoding, data[: len(data) // 2])
    with pytest.raises(FormatError, match=r"cut\.nrrd cannot be read"):
        load(tmp_path / "cut.nrrd")


@pytest.mark.parametrize("encoding", ["gzip", "bzip2"])
@pytest.mark.parametrize("skip", [0, 1 << 30])
def test_a_packed_nrrd_stops_at_its_declared_size(encoding, skip, tmp_path):
    import bz2
    import tracemalloc

    data = (gzip.compress if encoding == "gzip" else bz2.compress)(bytes(1 << 25))
    nrrd_with(tmp_path / "a.nrrd", encoding, data, f"byte skip: {skip}\n" if skip else "")
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match="unpack to more than the voxels that its header declares"):
            load(tmp_path / "a.nrrd")
        assert tracemalloc.get_traced_memory()[1] < 1 << 23
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("field", ["data file", "datafile"])
def test_an_nrrd_reads_no_file_elsewhere(field, tmp_path):
    values = np.arange(1000, dtype="<f4")
    (tmp_path / "in").mkdir()
    (tmp_path / "secret").write_bytes(values.tobytes())
    (tmp_path / "in" / "own.raw").write_bytes(values.tobytes())
    for name in (str(tmp_path / "secret"), "../secret", "x/../../secret"):
        nrrd_with(tmp_path / "in" / "a.nrrd", "raw", b"", f"{field}: {name}\n")
        with pytest.raises(FormatError, match="only files beside it are read"):
            load(tmp_path / "in" / "a.nrrd")
    nrrd_with(tmp_path / "in" / "a.nrrd", "raw", b"", f"{field}: own.raw\n")
    np.testing.assert_array_equal(load(tmp_path / "in" / "a.nrrd").numpy().ravel("F"), values)


@pytest.mark.parametrize(
    "field", ["data file: LIST\n../secret", "DataFile:LIST\nown.raw", "data file: own%d.raw 1 2 1"]
)
def test_an_nrrd_of_several_files(field, tmp_path):
    (tmp_path / "own.raw").write_bytes(np.zeros(1000, "<f4").tobytes())
    nrrd_with(tmp_path / "a.nrrd", "raw", b"", f"{field}\n")
    with pytest.raises(FormatError, match="has its values in several files, which are not read: join them"):
        load(tmp_path / "a.nrrd")


def test_a_damaged_record_of_a_zarr_is_found(tmp_path):
    path = tmp_path / "map.zarr"
    save(FIELD, path)
    text = (path / "zarr.json").read_text()
    document = json.loads(text)
    document["attributes"][KEY]["origin"][0] += 1e-3
    (path / "zarr.json").write_text(json.dumps(document))
    for call in (load, grid_like):
        with pytest.raises(FormatError, match="is not what sdm wrote"):
            call(path)
    del document["attributes"][KEY][CHECKSUM]
    del document["attributes"][KEY][RECORD_CHECKSUM]
    (path / "zarr.json").write_text(json.dumps(document))
    assert torch.equal(load(path).values, VALUES)


def test_a_record_that_lost_its_name_is_damage(tmp_path):
    path = tmp_path / "map.nrrd"
    save(FIELD, path)
    path.write_bytes(path.read_bytes().replace(b"sdm:=", b"sd-:="))
    with pytest.raises(FormatError, match="its record has lost its name"):
        load(path)
