"""The stream on a GPU: never waits for the device, ready on the consumer's stream, the same for every batch size."""

from __future__ import annotations

import itertools
import multiprocessing

import pytest
import torch

from sdm.core.demo_mesh import demo_mesh
from sdm.errors import DeviceError
from sdm.shapes import Cochlea, GeometricShapes, MeshFolder
from sdm.stream import Batch, SDMStream

pytestmark = pytest.mark.gpu

FAMILIES = {
    "cochlea": lambda: Cochlea(2_000),
    "solids": GeometricShapes,
    "folder": lambda: MeshFolder([demo_mesh(rings=41, segments=16, cap_rings=3), Cochlea(600).mesh([3, 0.5, 0.1, 0])]),
}


@pytest.fixture(params=FAMILIES)
def family(request):
    return FAMILIES[request.param]()


def stream(family, batch_size=4, resolution=32, **options):
    return SDMStream(family, family.grid(resolution), batch_size, seed=2, device="cuda", **options)


def take(source, steps):
    return [Batch(*parts) for parts in itertools.islice(source, steps)]


def together(batches):
    return Batch(*(torch.cat(parts) for parts in zip(*batches, strict=True)))


def test_never_waits_for_the_device(family):
    source = stream(family)
    expected = [b.sdm.clone() for b in take(source, 4)]
    again = stream(family)
    # Loads what is loaded on first use: modules, pinned memory, streams.
    take(stream(family), 4)
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        found = take(again, 4)
    finally:
        torch.cuda.set_sync_debug_mode("default")
    for batch, wanted in zip(found, expected, strict=True):
        assert torch.equal(batch.sdm, wanted)


def test_any_batch_size_gives_the_same_bits(family):
    whole = together(take(stream(family, 24), 1))
    for size in (1, 8):
        found = together(take(stream(family, size), 24 // size))
        assert all(torch.equal(a, b) for a, b in zip(found, whole, strict=True))


def test_batches_that_are_made_several_at_once(family):
    """At most 64 samples: 21 batches of 3, and the rest. Each is ready, and memory of its own."""
    assert stream(family).maker.at_once == 64
    whole = stream(family).sample(list(range(75)))
    batches = list(stream(family, 3, stop=75))
    assert len(batches) == 25
    found = together(batches)
    assert all(torch.equal(a, b) for a, b in zip(found, whole, strict=True))
    assert all(b.sdm.untyped_storage().nbytes() == b.sdm.nbytes for b in batches)


def test_parameters_are_those_of_the_cpu(family):
    here = SDMStream(family, family.grid(8), 16, seed=2, device="cpu")
    there = SDMStream(family, family.grid(8), 16, seed=2, device="cuda")
    a, b = take(here, 1)[0], take(there, 1)[0]
    assert torch.equal(a.theta, b.theta.cpu())
    torch.testing.assert_close(b.sdm.cpu().abs(), a.sdm.abs(), atol=1e-5, rtol=0)


def test_batches_are_ready_on_the_stream_that_reads_them():
    family = Cochlea(20_000)
    expected = [b.sdm.cpu() for b in take(stream(family, 8, 64), 6)]
    consumer = torch.cuda.Stream()
    sums = []
    with torch.cuda.stream(consumer):
        for batch in itertools.islice(stream(family, 8, 64), 6):
            # Keep the consumer behind, so that memory given back too early would be written over.
            torch.cuda._sleep(20_000_000)
            sums.append(batch.sdm * 1.0)
            del batch
    consumer.synchronize()
    for found, wanted in zip(sums, expected, strict=True):
        assert torch.equal(found.cpu(), wanted)


def test_a_state_taken_with_batches_in_flight_resumes_exactly(family):
    whole = take(stream(family, prefetch=3), 7)
    source = stream(family, prefetch=3)
    iterator = iter(source)
    for _ in range(4):
        next(iterator)
    # Three more are queued by now, and none of them has been given.
    assert source.position == 16
    again = stream(family, 8, prefetch=1)
    again.load_state_dict(source.state_dict())
    del iterator, source
    found = together(take(again, 1))
    assert found.index.tolist() == list(range(16, 24))
    assert torch.equal(found.sdm, torch.cat([b.sdm for b in whole[4:6]]))


def test_ddp_trains_on_it(tmp_path):
    """One process under NCCL has the losses that it has without."""

    def losses(wrap) -> list[float]:
        torch.manual_seed(0)
        net = wrap(torch.nn.Sequential(torch.nn.Linear(4, 32), torch.nn.Tanh(), torch.nn.Linear(32, 16**3)).cuda())
        optimizer = torch.optim.SGD(net.parameters(), 1e-2)
        found = []
        for theta, maps, _ in itertools.islice(stream(Cochlea(2_000), 8, 16), 10):
            loss = torch.nn.functional.mse_loss(net(theta).reshape_as(maps), maps)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            found.append(loss.detach())
        return torch.stack(found).tolist()

    alone = losses(lambda net: net)
    torch.distributed.init_process_group(
        "nccl", init_method=f"file://{tmp_path / 'meeting'}", rank=0, world_size=1, device_id=torch.device("cuda", 0)
    )
    try:
        under = losses(lambda net: torch.nn.parallel.DistributedDataParallel(net, device_ids=[0]))
    finally:
        torch.distributed.destroy_process_group()
    assert under == pytest.approx(alone, rel=1e-4)


def test_memory_stays_flat():
    source = iter(stream(Cochlea(2_000), 8))
    for _ in range(20):
        next(source)
    torch.cuda.synchronize()
    before = torch.cuda.memory_reserved()
    for step in range(200):
        batch = next(source)
        batch.sdm.sum()
        if step % 10 == 0:
            torch.cuda.synchronize()
    assert torch.cuda.memory_reserved() <= before + (64 << 20)


def test_a_compiled_step_takes_the_batches():
    net = torch.nn.Conv3d(1, 2, 3, padding=1).cuda()
    step = torch.compile(lambda x: net(x).square().mean(), dynamic=False)
    for batch in take(stream(Cochlea(2_000)), 3):
        expected = net(batch.sdm).square().mean()
        torch.testing.assert_close(step(batch.sdm), expected)


def _use_in_child(source, answers) -> None:
    try:
        next(iter(source))
        answers.put("no error")
    except DeviceError as error:
        answers.put(str(error))


def test_a_forked_worker_is_told_what_to_do():
    source = stream(Cochlea(600), resolution=8)
    context = multiprocessing.get_context("fork")
    answers = context.Queue()
    child = context.Process(target=_use_in_child, args=(source, answers))
    child.start()
    assert "num_workers=0" in answers.get(timeout=60)
    child.join()
