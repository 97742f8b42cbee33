"""A dataset holds bit for bit what the stream yields, and reads back with everything that belongs to a sample."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch
import zarr
from torch.utils.data import DataLoader

import sdm
from sdm.core.demo_mesh import demo_mesh
from sdm.dataset import SDMDataset, freeze, generate
from sdm.dataset.family_registry import FAMILIES as FAMILIES_BY_NAME
from sdm.dataset.family_registry import describe, family_from
from sdm.errors import FormatError, SDMError
from sdm.shapes import Cochlea, Ellipsoid, MeshFolder, families
from sdm.stream import SDMStream, Table

COUNT = 10
FAMILIES = {
    "cochlea": lambda: Cochlea(600),
    "folder": lambda: MeshFolder([demo_mesh(rings=41, segments=16, cap_rings=3), Cochlea(600).mesh([3, 0.5, 0.1, 0])]),
}


def write(path, family, **options):
    options = {"device": "cpu", "seed": 4, "shard": 4, **options}
    return SDMDataset(generate(family, family.grid(10), COUNT, path, **options))


@pytest.mark.parametrize("name", families)
def test_every_family_of_the_registry(tmp_path, name):
    family = families[name].example()
    data = write(tmp_path / "d.zarr", family, seed=2)
    expected = SDMStream(family, data.grid, COUNT, seed=2, device="cpu").sample(list(range(COUNT)))
    assert data.manifest["recipe"]["family"] == name
    assert torch.equal(torch.as_tensor(data.theta), expected.theta)
    assert torch.equal(data[COUNT - 1].sdm, expected.sdm[-1])
    assert data.manifest["transforms"] == family.places_meshes == (family.sample_transforms(expected.theta) is not None)


@pytest.mark.parametrize("name", FAMILIES_BY_NAME)
def test_a_record_of_a_name_makes_the_family_again(name):
    """Records of older datasets hold no more than that."""
    family = family_from({"family": name, "triangles": 600})
    assert family.fingerprint == families[name].example().fingerprint
    assert describe(name, {"triangles": 600, "warp": None}) == {"family": name, "triangles": 600}


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"sampler": "mixture:0.5", "compression": "none", "shard": 3},
        {"dtype": torch.float16, "truncate": 0.5, "sampler": "sobol", "shard": None},
    ],
    ids=["plain", "mixture", "half"],
)
def test_holds_what_the_stream_yields(tmp_path, family, options):
    if family == "folder" and options.get("sampler", "").startswith("mixture"):
        # A grid over 26 parameters is too large.
        options = {**options, "sampler": "sobol"}
    family = FAMILIES[family]()
    data = write(tmp_path / "d.zarr", family, **options)
    same = {key: value for key, value in options.items() if key not in ("shard", "compression")}
    batch = next(iter(SDMStream(family, family.grid(10), COUNT, seed=4, device="cpu", **same)))
    assert len(data) == COUNT
    for found, wanted in zip(next(iter(DataLoader(data, batch_size=COUNT))), batch, strict=True):
        assert found.dtype == wanted.dtype
        assert torch.equal(found, wanted)
    assert torch.equal(data.theta, batch.theta)
    assert data.grid == family.grid(10)
    assert [p.name for p in data.parameters] == [p.name for p in family.parameters]


def test_a_stream_is_frozen_in_one_call(tmp_path):
    family = Cochlea(600)
    options = {"sampler": "mixture:0.25", "dtype": torch.float16, "truncate": 1.0, "device": "cpu"}
    stream = SDMStream(family, family.grid(10), 3, 9, **options)
    expected = [next(iter(stream)) for _ in range(3)]
    data = SDMDataset(freeze(stream, 9, tmp_path / "d.zarr", shard=4))
    assert stream.position == 9
    for found, wanted in zip(DataLoader(data, batch_size=3), expected, strict=True):
        assert all(torch.equal(a, b) for a, b in zip(found, wanted, strict=True))


def test_any_zarr_reader_reads_it(tmp_path):
    data = write(tmp_path / "d.zarr", Cochlea(600))
    group = zarr.open_group(tmp_path / "d.zarr", mode="r")
    names = sorted(name for name, _ in group.members())
    assert names == ["sdm", "sha256", "theta"]
    assert group.metadata.zarr_format == 3
    whole = group["sdm"][:]
    assert group["sdm"].shards == (4, 10, 10, 10)
    assert (torch.from_numpy(whole[7]) == data[7].sdm[0]).all()
    manifest = group.attrs["sdm"]
    assert manifest["recipe"]["seed"] == 4
    assert manifest["recipe"]["fingerprint"] == Cochlea(600).fingerprint
    assert manifest["device"] == "cpu"
    assert manifest["sdm_version"] == sdm.__version__


def test_the_way_back_to_the_users_mesh(tmp_path):
    family = FAMILIES["folder"]()
    data = write(tmp_path / "d.zarr", family)
    for number in range(COUNT):
        theta = data.theta[number : number + 1].clone()
        theta[:, 8:] = 0
        group = next(iter(family.groups(theta)))
        back = data.inverse_transform(number)
        points = group.vertices[0].double() @ back[:3, :3].T + back[:3, 3]
        own = family.meshes[int(theta[0, 0])].vertices.double()
        assert float((points - own).abs().max()) < 1e-5 * float(own.abs().max())
    plain = write(tmp_path / "c.zarr", Cochlea(600))
    assert torch.equal(plain.inverse_transform(3), torch.eye(4, dtype=torch.float64))


def test_workers_and_copies_read_it(tmp_path):
    data = write(tmp_path / "d.zarr", Cochlea(600))
    here = torch.stack([data[i].sdm for i in range(COUNT)])
    loader = DataLoader(data, batch_size=5, num_workers=2, multiprocessing_context="fork")
    assert torch.equal(torch.cat([b.sdm for b in loader]), here)
    assert torch.equal(pickle.loads(pickle.dumps(data))[3].sdm, here[3])
    assert torch.equal(data[-1].sdm, here[-1])
    field = data.sdm(2)
    assert torch.equal(field.values, here[2, 0])
    assert field.grid == data.grid
    with pytest.raises(IndexError, match="there is no number 10"):
        data[COUNT]
    for item in (1.5, slice(2), [1, 2]):
        with pytest.raises(SDMError, match="no number of a sample: give one whole number"):
            data[item]
    with pytest.raises(FormatError, match="is a dataset of maps: sdm explore shows it"):
        sdm.load(data.path)


def test_what_makes_no_sense_is_refused_before_anything_is_written(tmp_path):
    family = Cochlea(600)
    grid = family.grid(8)
    for options, message in (
        ({"count": 0}, "0 samples"),
        ({"shard": 0}, "shard of 0"),
        ({"compression": "gzip"}, "no compression called"),
        ({"dtype": torch.bfloat16}, "float32 or float16"),
        ({"truncate": -1.0}, "truncation"),
        ({"sampler": "x"}, "no sampler"),
        ({"path": tmp_path / "no" / "d.zarr"}, "make it first"),
    ):
        call = {"count": 4, "path": tmp_path / "d.zarr", "device": "cpu", **options}
        with pytest.raises(SDMError, match=message):
            generate(family, grid, call.pop("count"), call.pop("path"), **call)
    assert list(tmp_path.iterdir()) == []


def test_a_table_can_be_frozen(tmp_path):
    family = Cochlea(600)
    table = Table(family.sample(COUNT, device="cpu"), shuffle=False)
    assert torch.equal(write(tmp_path / "d.zarr", family, sampler=table).theta, table.rows)


def test_numbers_may_be_numpys(tmp_path):
    family = Ellipsoid(triangles=12, sizes=(np.float32(0.2), np.float32(0.8)))
    stream = SDMStream(family, family.grid(4), 2, device="cpu")
    data = SDMDataset(freeze(stream, np.int64(3), tmp_path / "d.zarr", shard=np.int64(2)))
    assert torch.equal(data[2].sdm, stream.sample(2).sdm[0])


def test_a_family_of_ones_own_may_have_meshes(tmp_path):
    class Mine(Ellipsoid):
        meshes = ("what it was", "made from")

    family = Mine(triangles=12)
    assert len(SDMDataset(generate(family, family.grid(4), 2, tmp_path / "d.zarr", device="cpu"))) == 2


def test_other_folders_are_no_datasets(tmp_path):
    with pytest.raises(FormatError, match="not a dataset"):
        SDMDataset(tmp_path)
    zarr.create_array(store=tmp_path / "a.zarr", shape=(2,), dtype="float32")
    with pytest.raises(FormatError, match="not a dataset"):
        SDMDataset(tmp_path / "a.zarr")
