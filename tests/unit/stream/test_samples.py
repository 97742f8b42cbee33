"""A sample is a pure function of seed and number: the same for every batch size, rank count and restart."""

from __future__ import annotations

import copy
import itertools
import json
import pickle

import numpy as np
import pytest
import torch

import sdm
from sdm.core.demo_mesh import demo_mesh
from sdm.errors import DeviceError, SDMError
from sdm.shapes import Cochlea, Ellipsoid, GeometricShapes, MeshFolder
from sdm.stream import Batch, SDMStream, TensorGrid

FAMILIES = {
    "cochlea": lambda: Cochlea(600),
    "solids": lambda: GeometricShapes(triangles=108, sizes=(0.5, 0.8)),
    "folder": lambda: MeshFolder([demo_mesh(rings=41, segments=16, cap_rings=3), Cochlea(600).mesh([3, 0.5, 0.1, 0])]),
}


@pytest.fixture(params=FAMILIES)
def family(request):
    return FAMILIES[request.param]()


def stream(family, batch_size=4, **options):
    options = {"device": "cpu", "seed": 5, **options}
    return SDMStream(family, family.grid(12), batch_size, **options)


def take(source, steps):
    return [Batch(*parts) for parts in itertools.islice(source, steps)]


def together(batches) -> Batch:
    return Batch(*(torch.cat(parts) for parts in zip(*batches, strict=True)))


def same(a: Batch, b: Batch) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a, b, strict=True))


def test_maps_are_those_of_the_engine(family):
    batch = take(stream(family), 1)[0]
    assert batch.sdm.shape == (4, 1, 12, 12, 12)
    assert batch.sdm.dtype == torch.float32
    assert batch.index.tolist() == [0, 1, 2, 3]
    assert torch.equal(batch.theta, family.sample(4, seed=5, device="cpu"))
    for theta, values in zip(batch.theta, batch.sdm, strict=True):
        alone = next(iter(family.groups(theta[None])))
        mesh = sdm.TriangleMesh(alone.vertices[0], alone.faces)
        assert torch.equal(values[0], sdm.signed_distance_map(mesh, family.grid(12), device="cpu").values)
    assert bool((batch.sdm < 0).flatten(1).any(1).all())


def test_grids_of_images_may_be_turned(family):
    plain = family.grid(12)
    grid = sdm.Grid(plain.origin, plain.spacing, (8, 9, 10), [[0, -0.6, 0.8], [1, 0, 0], [0, 0.8, 0.6]])
    source = SDMStream(family, grid, 3, device="cpu")
    batch = source.sample([0, 1, 2])
    for theta, values in zip(batch.theta, batch.sdm, strict=True):
        alone = next(iter(family.groups(theta[None])))
        mesh = sdm.TriangleMesh(alone.vertices[0], alone.faces)
        assert torch.equal(values[0], sdm.signed_distance_map(mesh, grid, device="cpu").values)
    assert sdm.Grid(**source.state_dict()["recipe"]["grid"]) == grid


def test_any_batch_size_gives_the_same_samples(family):
    whole = together(take(stream(family, 12), 1))
    for size in (1, 3, 4):
        assert same(together(take(stream(family, size), 12 // size)), whole)


def test_ranks_are_disjoint_and_make_the_global_batch(family):
    steps = [take(stream(family, 2, rank=rank, world_size=3), 2) for rank in range(3)]
    for step, expected in enumerate(take(stream(family, 6), 2)):
        assert same(together([steps[rank][step] for rank in range(3)]), expected)


def test_ranks_come_from_the_launcher(family, monkeypatch):
    monkeypatch.setenv("RANK", "1")
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert take(stream(family), 1)[0].index.tolist() == [4, 5, 6, 7]
    assert take(stream(family, rank=0, world_size=1), 1)[0].index.tolist() == [0, 1, 2, 3]


def test_a_stream_made_before_the_process_group_finds_its_rank(family, monkeypatch):
    source = pickle.loads(pickle.dumps(stream(family)))
    assert (source.rank, source.world_size) == (0, 1)
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_rank", lambda: 1)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 2)
    assert take(source, 1)[0].index.tolist() == [4, 5, 6, 7]
    assert source.position == 8
    assert take(stream(family, rank=0, world_size=1), 1)[0].index.tolist() == [0, 1, 2, 3]
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: False)
    short = stream(family, stop=12)
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    with pytest.raises(SDMError, match="multiple of the 8"):
        next(iter(short))


def test_goes_on_where_it_was(family):
    first = stream(family)
    before = take(first, 2)
    state = first.state_dict()
    after = take(first, 2)
    assert after[0].index.tolist() == [8, 9, 10, 11]
    assert not set(before[0].index.tolist()) & set(after[0].index.tolist())
    for resumed in (stream(family), copy.deepcopy(first), pickle.loads(pickle.dumps(first))):
        resumed.load_state_dict(state)
        assert same(together(take(resumed, 2)), together(after))
    # Another number of ranks and another batch size share out the same samples.
    parts = []
    for rank in range(2):
        resumed = stream(family, 2, rank=rank, world_size=2)
        resumed.load_state_dict(state)
        parts.append(take(resumed, 1))
    assert same(together([p[0] for p in parts]), after[0])


def test_state_counts_a_batch_once_it_is_given(family):
    source = stream(family)
    iterator = iter(source)
    assert source.state_dict()["position"] == 0
    next(iterator)
    assert source.state_dict()["position"] == 4


def test_batches_are_fresh_memory(family):
    first, second = take(stream(family), 2)
    assert first.sdm.data_ptr() != second.sdm.data_ptr()
    kept = first.sdm.clone()
    second.sdm.zero_()
    assert torch.equal(first.sdm, kept)


def test_several_batches_by_one_call_are_the_same_batches(family):
    maker = stream(family).maker
    indices = torch.tensor([[0, 1], [7, 2], [3, 1]])
    with torch.inference_mode():
        found = maker.make_several(indices)
    for batch, index in zip(found, indices, strict=True):
        assert same(batch, maker.make(index))
        assert not batch.sdm.is_inference()
        # Whoever keeps one does not keep the others.
        assert batch.sdm.untyped_storage().nbytes() == batch.sdm.nbytes


def test_as_many_at_once_as_there_is_room_for():
    family = Cochlea(600)
    triangles = len(family.faces)

    def at_once(resolution: int, family=family) -> int:
        return SDMStream(family, family.grid(resolution), device="cpu").maker.at_once

    assert [at_once(n) for n in (16, 64, 128, 256)] == [64, 64, 16, 2]
    fine = Cochlea(40_000)
    assert at_once(16, fine) == (1 << 21) // len(fine.faces) < 64
    meshes = [family.mesh([3, 0.5, 0.1, 0])] * 3
    assert at_once(16, MeshFolder(meshes)) == 64 < (1 << 21) // triangles


def test_what_the_caller_has_turned_on_changes_nothing(family):
    expected = take(stream(family), 1)[0]
    source = stream(family)
    with torch.inference_mode(), torch.autocast("cpu", dtype=torch.bfloat16):
        found = take(source, 1)[0]
    assert same(found, expected)
    assert not found.sdm.is_inference()
    assert not found.sdm.requires_grad


def test_sample_gives_any_numbers(family):
    source = stream(family)
    whole = take(source, 2)
    found = source.sample([6, 1, 1])
    assert found.index.tolist() == [6, 1, 1]
    expected = together(whole)
    assert torch.equal(found.sdm, expected.sdm[[6, 1, 1]])
    with pytest.raises(SDMError, match="no sample was requested"):
        source.sample([])
    with pytest.raises(SDMError, match="numbered from 0"):
        source.sample(-1)


def test_half_precision_and_truncation(family):
    full = take(stream(family), 1)[0].sdm
    limit = float(full.abs().median())
    half = take(stream(family, dtype=torch.float16, truncate=limit), 1)[0].sdm
    assert torch.equal(half, full.clamp(-limit, limit).half())


def test_half_precision_must_hold_the_distances():
    family = Ellipsoid(triangles=108, sizes=(5e4, 1e5))
    for truncate in (None, 1e5):
        with pytest.raises(SDMError, match="float16 ends at 65504: use float32, or truncate"):
            stream(family, dtype=torch.float16, truncate=truncate)
    for options in ({"dtype": torch.float16, "truncate": 6e4}, {"dtype": torch.bfloat16}):
        assert bool(stream(family, 4, **options).sample(0).sdm.isfinite().all())
    with pytest.raises(SDMError, match=r"voxels of .* are too small for float16, whose steps are 6e-08"):
        stream(Ellipsoid(triangles=108, sizes=(1e-7, 2e-7)), dtype=torch.float16)


def test_stops_where_it_is_told(family):
    source = stream(family, start=8, stop=16)
    assert [b.index.tolist() for b in source] == [[8, 9, 10, 11], [12, 13, 14, 15]]
    assert list(source) == []


def test_goes_on_to_its_stop_and_no_further(monkeypatch):
    family = Cochlea(600)
    first = stream(family, 4, stop=16)
    take(first, 1)
    state = first.state_dict()
    resumed = stream(family, 6, stop=12)
    with pytest.raises(SDMError, match=r"from sample 4 to 12, 8 samples, .* of the 6 of"):
        resumed.load_state_dict(state)
    assert resumed.position == 0
    resumed = stream(family, 2, stop=16)
    resumed.load_state_dict(state)
    assert [i for b in resumed for i in b.index.tolist()] == list(range(4, 16))
    # The process group may be made after the state is loaded.
    resumed = stream(family, 4, stop=16)
    resumed.load_state_dict(state)
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_rank", lambda: 0)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 2)
    with pytest.raises(SDMError, match=r"from sample 4 to 16, 12 samples, .* of the 8 of"):
        next(iter(resumed))


def test_refuses_what_makes_no_sense():
    family = Cochlea(600)
    grid = family.grid(8)
    for options, message in (
        ({"batch_size": 0}, "batch size is 0"),
        ({"prefetch": 0}, "prefetch is 0; give at least 1 batch"),
        ({"rank": 2, "world_size": 2}, "rank is 2 of 2"),
        ({"rank": 1}, "both, or neither"),
        ({"start": -1}, "from sample -1"),
        ({"start": 0, "stop": 5}, "multiple of the 16"),
        ({"sampler": "halton"}, "no sampler called 'halton'"),
        ({"dtype": torch.int8}, "torch.int8 are not supported"),
        ({"truncate": 0.0}, "truncation 0.0"),
    ):
        with pytest.raises(SDMError, match=message):
            SDMStream(family, grid, **{"device": "cpu", **options})
    for sampler in (TensorGrid(5), "mixture:0.5"):
        with pytest.raises(SDMError, match="too large"):
            SDMStream(FAMILIES["folder"](), grid, device="cpu", sampler=sampler)
    if not torch.cuda.is_available():
        with pytest.raises(DeviceError, match="no CUDA device"):
            SDMStream(family, grid, device="cuda")


def test_states_are_ready_for_json_whatever_numbers_were_given():
    family = Cochlea(600)
    source = SDMStream(
        family, family.grid(8), 2, device="cpu", truncate=np.float32(0.5), start=np.int64(4), stop=np.int64(8)
    )
    assert [batch.index.tolist() for batch in source] == [[4, 5], [6, 7]]
    assert json.loads(json.dumps(source.state_dict())) == source.state_dict()


def test_state_of_another_stream_is_refused():
    state = stream(Cochlea(600)).state_dict()
    for other, key in (
        (stream(Cochlea(600), seed=6), "seed is 5, but here it is 6"),
        (stream(Cochlea(900)), "fingerprint"),
        (stream(Cochlea(600), sampler="sobol"), "sampler is uniform"),
    ):
        with pytest.raises(SDMError, match=key):
            other.load_state_dict(state)
    del state["recipe"]["draws"]
    with pytest.raises(SDMError, match="draws is 1, but here it is 2"):
        stream(Cochlea(600)).load_state_dict(state)
    with pytest.raises(SDMError, match="not the state"):
        stream(Cochlea(600)).load_state_dict({})
