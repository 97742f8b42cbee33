"""Calls by table, made on a CPU without a recording."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from sdm.runtime.graphs import TableCall


def by_table(call: TableCall) -> tuple[Any, list[int], int]:
    """Results of a call, all numbers that it told, and how many of these are no flags."""
    table = torch.zeros(call.of.length, dtype=torch.float64)
    results = call.fill(memoryview(table.numpy()), call.of.new())
    said: list[int] = []
    told = 0

    def verify(flags: torch.Tensor, count: int = 0, write: Callable[[int], None] | None = None) -> None:
        nonlocal told
        if write is not None:
            flags = torch.empty_like(flags)
            write(flags.data_ptr())
        said.extend(flags.tolist())
        told = count

    call.of.work(verify, table)
    return results if call.launched is None else call.launched(results), said, told
