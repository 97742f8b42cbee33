"""Two processes under DDP (gloo) train as one process with the same global batch does."""

from __future__ import annotations

import itertools
import socket

import pytest
import torch
import torch.distributed as dist
import torch.multiprocessing as mp
from torch.nn.functional import mse_loss
from torch.nn.parallel import DistributedDataParallel

from sdm.shapes import Cochlea
from sdm.stream import SDMStream

FAMILY = Cochlea(600)
GRID = FAMILY.grid(6)
STEPS, GLOBAL = 5, 8


def train(batch_size: int) -> list[float]:
    """Losses of each step, averaged over the ranks; the stream finds its rank by itself."""
    torch.manual_seed(0)
    net: torch.nn.Module = torch.nn.Sequential(torch.nn.Linear(4, 32), torch.nn.Tanh(), torch.nn.Linear(32, 6**3))
    if dist.is_initialized():
        net = DistributedDataParallel(net)
    optimizer = torch.optim.Adam(net.parameters(), 1e-2)
    losses = []
    for theta, maps, _ in itertools.islice(SDMStream(FAMILY, GRID, batch_size, device="cpu"), STEPS):
        loss = mse_loss(net(theta).reshape_as(maps), maps)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        mean = loss.detach().clone()
        if dist.is_initialized():
            dist.all_reduce(mean)
            mean /= dist.get_world_size()
        losses.append(float(mean))
    return losses


def one_rank(rank: int, world: int, port: int, answers) -> None:
    torch.set_num_threads(1)
    dist.init_process_group("gloo", f"tcp://127.0.0.1:{port}", rank=rank, world_size=world)
    losses = train(GLOBAL // world)
    if rank == 0:
        answers.put(losses)
    dist.barrier()
    dist.destroy_process_group()


@pytest.mark.slow
def test_two_processes_have_the_losses_of_one():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    answers = mp.get_context("spawn").SimpleQueue()
    mp.spawn(one_rank, (2, port, answers), nprocs=2)
    expected = train(GLOBAL)
    assert expected[-1] < expected[0]
    assert answers.get() == pytest.approx(expected, rel=1e-5)
