"""Cache of the recordings of one device: calls are counted, and the recordings used last are kept.

Those that serve calls of many kinds, and those of one, make room among themselves: a folder of meshes, each asked about
some times, would otherwise drive out the recordings that the first call of each one needs.
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial
from typing import Any

import torch

from sdm.runtime.graphs.captured_call import CapturedCall, Recording, Work
from sdm.runtime.graphs.memory_pool import MemoryPool

# A call is recorded once it has come this often, as a recording takes as long as some calls.
CALLS = 3
# One that serves calls of many kinds is recorded before the first of them, which it serves too.
CALLS_OF_MANY = 1
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
_NEEDED = {False: CALLS, True: CALLS_OF_MANY}


class Kept:
    """A recording that is kept, until it goes: who keeps this need not look for it, but has to tell that it is used.

    Args:
        recording: None once it is gone.
        for_many: It serves calls of many kinds.
        is_used: To be called for each use that did not begin with `GraphCache.find`.
    """

    __slots__ = ("for_many", "is_used", "recording", "used")

    def __init__(self, recording: Recording, for_many: bool, is_used: Callable[[], object]) -> None:
        self.recording: Recording | None = recording
        self.for_many, self.is_used, self.used = for_many, is_used, 0


class GraphCache:
    """The recordings of one device: those used last.

    Args:
        most: Bytes that all of them may take.
        capture: Makes a recording of a work and its inputs in some pool.
        recordings: How many there may be for calls of one kind.
        of_many: And for calls of many kinds; None: as many.
    """

    def __init__(
        self,
        most: int,
        capture: Callable[[MemoryPool, Work, Any], Recording] = CapturedCall,
        recordings: int = FEW_RECORDINGS,
        of_many: int | None = None,
    ) -> None:
        self._most = most
        self._recordings = {False: recordings, True: recordings if of_many is None else of_many}
        self._capture = capture
        self._pool = MemoryPool()
        self._captured: OrderedDict[Hashable, Kept] = OrderedDict()
        self._calls: OrderedDict[Hashable, int] = OrderedDict()
        self._needed = dict(_NEEDED)

    @property
    def needed(self) -> int:
        """Calls of one kind until they are recorded."""
        return self._needed[False]

    @property
    def last_launch(self) -> torch.cuda.Event | None:
        """Event after the last launch of a recording."""
        return self._pool.last_launch

    def __len__(self) -> int:
        return len(self._captured)

    def __contains__(self, key: Hashable) -> bool:
        return key in self._captured

    def kept(self, key: Hashable) -> Kept | None:
        """The recording of the calls with a key as it is kept, if there is one."""
        return self._captured.get(key)

    def find(self, key: Hashable) -> Recording | None:
        """The recording of the calls with a key, if there is one."""
        found = self._captured.get(key)
        if found is None:
            return None
        self._captured.move_to_end(key)
        found.used += 1
        if found.used == WELL_WORTH:
            self._needed[found.for_many] = _NEEDED[found.for_many]
        return found.recording

    def count(
        self,
        key: Hashable,
        work: Work,
        inputs: Any,
        for_many: bool = False,
        capture: Callable[[MemoryPool, Work, Any], Recording] | None = None,
        later: int = 0,
    ) -> None:
        """Count a call that has no recording, and record it if it came often enough.

        Args:
            key: Of the call.
            work: Of the call.
            inputs: What a recording is made with.
            for_many: The recording will serve calls of many kinds.
            capture: What makes it, if not the cache's own.
            later: By how many calls it has to come more often.
        """
        self._calls[key] = self._calls.pop(key, 0) + 1
        while len(self._calls) > MOST_KEYS:
            self._calls.popitem(last=False)
        if self._calls[key] < self._needed[for_many] + later or key in self._captured:
            return
        self._calls[key] = 0
        alike = [other for other, kept in self._captured.items() if kept.for_many == for_many]
        for oldest in alike[: max(0, len(alike) + 1 - self._recordings[for_many])]:
            self._raise_threshold(for_many, self._captured[oldest].used)
            self.drop(oldest)
        try:
            made = (capture or self._capture)(self._pool, work, inputs)
        except RuntimeError as error:
            # The call itself has its result.
            self._calls[key] = _REFUSED
            warnings.warn(f"a call could not be recorded, and will not be replayed: {error}", stacklevel=2)
            return
        if self._pool.nbytes <= self._most:
            self._captured[key] = Kept(made, for_many, partial(self.find, key))
            return
        if not self._captured:
            self._calls[key] = _REFUSED
        # Memory of one pool goes back together.
        self._raise_threshold(for_many, min((kept.used for kept in self._captured.values()), default=WORTH))
        self.clear()

    def _raise_threshold(self, for_many: bool, used: int) -> None:
        """Wait for more calls before the next such recording, if one that has to go was used so little."""
        if used < WORTH:
            self._needed[for_many] = min(2 * self._needed[for_many], MOST_CALLS)

    def drop(self, key: Hashable) -> None:
        """Forget a recording."""
        gone = self._captured.pop(key, None)
        if gone is not None:
            gone.recording = None
        if not self._captured:
            self.clear()

    def reset(self) -> None:
        """Drop all recordings and counts."""
        self.clear()
        self._calls.clear()
        self._needed = dict(_NEEDED)

    def clear(self) -> None:
        """Give up all recordings; those under way go on."""
        for gone in self._captured.values():
            gone.recording = None
        self._captured.clear()
        self._pool = MemoryPool(self._pool)
