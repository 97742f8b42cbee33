"""Time of a call: medians, with the device waited for."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch


@dataclass(frozen=True)
class Timing:
    """Milliseconds: the median of `runs` calls, and how far the slowest is from the fastest, in percent of it."""

    ms: float
    spread: float
    runs: int


def once(call: Callable[[], Any], device: str) -> tuple[float, Any]:
    """Milliseconds of one call, by CUDA events on a GPU, and what it returned."""
    if device.startswith("cuda"):
        with torch.cuda.device(device):
            begin, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
            torch.cuda.synchronize()
            begin.record()
            result = call()
            end.record()
            end.synchronize()
            return begin.elapsed_time(end), result
    start = time.perf_counter()
    result = call()
    return 1e3 * (time.perf_counter() - start), result


def median(call: Callable[[], Any], device: str, runs: int, budget_ms: float = float("inf")) -> Timing:
    """Time of a call that has run before: at most `runs` times, fewer if they take longer than the budget."""
    times: list[float] = []
    while len(times) < runs and (not times or sum(times) + max(times) <= budget_ms):
        times.append(once(call, device)[0])
    return _summary(times)


def by_turns(
    calls: dict[str, Callable[[], Any]], device: str, runs: int, budget_ms: float, warm_ms: float = 300.0
) -> dict[str, Timing]:
    """Times of calls that have run before and are compared: one call of each in turn, at most `runs` times.

    A GPU that was idle, as while a peer worked on the host, runs at a low clock at first: so all are called for
    `warm_ms` before they are timed. `budget_ms` is what the turns may take together.
    """
    begin = time.perf_counter()
    while 1e3 * (time.perf_counter() - begin) < warm_ms:
        for call in calls.values():
            once(call, device)
    times: dict[str, list[float]] = {name: [] for name in calls}
    total = longest = 0.0
    for turn in range(runs):
        if turn and total + longest > budget_ms:
            break
        last = {name: once(call, device)[0] for name, call in calls.items()}
        for name, milliseconds in last.items():
            times[name].append(milliseconds)
        total, longest = total + sum(last.values()), max(longest, sum(last.values()))
    return {name: _summary(found) for name, found in times.items()}


def _summary(times: list[float]) -> Timing:
    middle = statistics.median(times)
    return Timing(middle, 100 * (max(times) - min(times)) / middle if middle else 0.0, len(times))
