"""Simulation of a pipeline of three stages: reading in threads, measuring in the caller's, writing in threads."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Draw = Callable[[int], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """A pipeline as `sdm.cli.maps.map_job` builds it.

    Args:
        readers: Threads of reading.
        writers: Threads of writing.
        together: Items that are measured in one call.
        read: Seconds of reading for so many items.
        measure: Seconds of the calls that measure up to `together` items.
        write: Seconds of writing for so many items.
    """

    readers: int
    writers: int
    together: int
    read: Draw
    measure: Draw
    write: Draw

    def seconds(self, count: int) -> float:
        """Seconds until `count` items are written.

        Queues are bounded as in `sdm.runtime.pipeline.stages`: reading is ahead by two items a reader, or by two calls
        where that is more; the caller waits for the oldest item in writing once two items a writer are held there.
        """
        ahead, held = 2 * max(self.readers, self.together), 2 * self.writers
        read, write, calls = self.read(count), self.write(count), self.measure(-(-count // self.together))
        taken, written = np.zeros(count), np.zeros(count)
        readers, writers = [0.0] * self.readers, [0.0] * self.writers
        begun, ready, now = 0, np.zeros(count), 0.0
        for call, first in enumerate(range(0, count, self.together)):
            last = min(first + self.together, count)
            # An item can be begun once the one so far ahead of it was taken, which of all up to here is known.
            while begun < min(max(first + ahead, last), count):
                room = taken[begun - ahead] if begun >= ahead else 0.0
                end = max(heapq.heappop(readers), room) + read[begun]
                heapq.heappush(readers, end)
                ready[begun] = end
                begun += 1
            now = max(now, float(ready[first:last].max()))
            taken[first:last] = now
            now += calls[call]
            for item in range(first, last):
                if item >= held:
                    now = max(now, float(written[item - held]))
                end = max(heapq.heappop(writers), now) + write[item]
                heapq.heappush(writers, end)
                written[item] = end
        return float(max(written.max(), now))
