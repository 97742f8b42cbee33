"""The process group of a run under torchrun."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch

from sdm.core.device import choose_device


@contextmanager
def process_group(device: str | torch.device | None) -> Iterator[torch.device]:
    """Join torchrun's processes, if this is one of them, and leave them at the end.

    Gives the device to use: this process's own GPU where `device` is "auto" or "cuda" and there are several.
    """
    if "RANK" not in os.environ or torch.distributed.is_initialized():
        yield choose_device(device)
        return
    where = choose_device(device)
    if where.type == "cuda":
        where = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
        torch.cuda.set_device(where)
    torch.distributed.init_process_group("nccl" if where.type == "cuda" else "gloo")
    try:
        yield where
    finally:
        torch.distributed.destroy_process_group()


def is_first() -> bool:
    """True in the process that speaks and writes."""
    return os.environ.get("RANK", "0") == "0"
