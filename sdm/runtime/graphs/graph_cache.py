"""Cache of the recordings of one device: calls are counted, and the recordings used last are kept."""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable

from sdm.runtime.graphs.captured_call import CapturedCall, Tensors, Work
from sdm.runtime.graphs.memory_pool import MemoryPool

# A call is recorded once it has come this often, as a recording takes as long as some calls.
CALLS = 3
# One that serves calls of many kinds is recorded so many calls earlier.
EARLIER = 1
# One that has to make room before it was used so often was not worth it (a recording takes 12 ms and saves up to 1.5 ms
# a call): from then on calls have to come twice as often, up to a limit, until one is used much more often than that.
# Otherwise many keys by turns, as of a folder of meshes, would be recorded again and again.
WORTH = 8
WELL_WORTH = 4 * WORTH
MOST_CALLS = 64 * CALLS
# Kept of each device, if nobody says otherwise.
FEW_RECORDINGS = 4
# Keys whose calls are counted.
MOST_KEYS = 64
_REFUSED = -(1 << 62)


class GraphCache:
    """The recordings of one device: those used last.

    Args:
        most: Bytes that all of them may take.
        capture: Makes a recording of a work and its inputs in some pool.
        recordings: How many there may be.
    """

    def __init__(
        self,
        most: int,
        capture: Callable[[MemoryPool, Work, Tensors], CapturedCall] = CapturedCall,
        recordings: int = FEW_RECORDINGS,
    ) -> None:
        self._most, self._recordings = most, recordings
        self._capture = capture
        self._pool = MemoryPool()
        self._captured: OrderedDict[Hashable, CapturedCall] = OrderedDict()
        self._calls: OrderedDict[Hashable, int] = OrderedDict()
        self._used: dict[Hashable, int] = {}
        self.needed = CALLS

    def __len__(self) -> int:
        return len(self._captured)

    def __contains__(self, key: Hashable) -> bool:
        return key in self._captured

    def find(self, key: Hashable) -> CapturedCall | None:
        """The recording of the calls with a key, if there is one."""
        found = self._captured.get(key)
        if found is not None:
            self._captured.move_to_end(key)
            self._used[key] += 1
            if self._used[key] == WELL_WORTH:
                self.needed = CALLS
        return found

    def count(self, key: Hashable, work: Work, inputs: Tensors, earlier: int = 0) -> None:
        """Count a call that went without a recording, and record it if it came often enough, or but for `earlier`."""
        self._calls[key] = self._calls.pop(key, 0) + 1
        while len(self._calls) > MOST_KEYS:
            self._calls.popitem(last=False)
        if self._calls[key] < self.needed - earlier or key in self._captured:
            return
        self._calls[key] = 0
        while len(self._captured) >= self._recordings:
            oldest = next(iter(self._captured))
            self._raise_threshold(self._used[oldest])
            self.drop(oldest)
        try:
            made = self._capture(self._pool, work, inputs)
        except RuntimeError as error:
            # The call itself has its result.
            self._calls[key] = _REFUSED
            warnings.warn(f"a call could not be recorded, and will not be replayed: {error}", stacklevel=2)
            return
        if self._pool.nbytes <= self._most:
            self._captured[key], self._used[key] = made, 0
            return
        if not self._captured:
            self._calls[key] = _REFUSED
        # Memory of one pool goes back together.
        self._raise_threshold(min(self._used.values(), default=WORTH))
        self.clear()

    def _raise_threshold(self, used: int) -> None:
        """Wait for more calls before the next recording, if one that has to go was used so little."""
        if used < WORTH:
            self.needed = min(2 * self.needed, MOST_CALLS)

    def drop(self, key: Hashable) -> None:
        """Forget a recording."""
        self._captured.pop(key, None)
        self._used.pop(key, None)
        if not self._captured:
            self.clear()

    def reset(self) -> None:
        """Drop all recordings and counts."""
        self.clear()
        self._calls.clear()
        self.needed = CALLS

    def clear(self) -> None:
        """Give up all recordings; those under way go on."""
        self._captured.clear()
        self._used.clear()
        self._pool = MemoryPool(self._pool)
