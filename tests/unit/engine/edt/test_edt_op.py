"""The transform as a torch operator: fake tensors, compiled code, no wait for the device."""

from __future__ import annotations

import pytest
import torch

from sdm.engine.distance_transform import euclidean_distance_transform


def blobs(device="cpu", shape=(2, 1, 9, 8, 40)) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(3)).to(device) < 0.1


@pytest.mark.parametrize("signed", [False, True])
def test_opcheck(signed, device):
    mask = blobs(device)[:, 0]
    arguments = (mask, [1.0, 2.0, 0.5], 0.5, signed, float("inf"))
    torch.library.opcheck(torch.ops.sdm.euclidean_distance_transform.default, arguments)
    torch.library.opcheck(torch.ops.sdm.euclidean_distance_transform.default, (mask.transpose(1, 3), *arguments[1:]))


def test_compiled():
    compiled = torch.compile(lambda m: euclidean_distance_transform(m, 2.0, signed=True) * 2, backend="aot_eager")
    assert torch.equal(compiled(blobs()), 2 * euclidean_distance_transform(blobs(), 2.0, signed=True))


@pytest.mark.gpu
def test_nothing_waits_for_the_gpu():
    mask = blobs("cuda")
    expected = euclidean_distance_transform(mask.cpu(), (1, 2, 3), signed=True)
    euclidean_distance_transform(mask, (1, 2, 3), signed=True)
    torch.cuda.set_sync_debug_mode("error")
    try:
        values = euclidean_distance_transform(mask, (1, 2, 3), signed=True)
    finally:
        torch.cuda.set_sync_debug_mode("default")
    torch.testing.assert_close(values.cpu(), expected, rtol=2.0**-22, atol=0)


@pytest.mark.gpu
def test_on_another_stream():
    mask = blobs("cuda", (4, 64, 64, 64))
    expected = euclidean_distance_transform(mask.cpu())
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        values = [euclidean_distance_transform(mask) for _ in range(5)]
    stream.synchronize()
    for value in values:
        torch.testing.assert_close(value.cpu(), expected, rtol=2.0**-22, atol=0)
