"""The recordings of one device: which calls are worth one, and which recordings are kept."""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable

from sdm.runtime.captured_call import Inputs, Recording, Room, Work

# A call is recorded once it has come this often, as a recording takes as long as some calls.
CALLS = 3
# One that has to make room before it was used so often was not worth it (a recording takes 12 ms and saves up to 1.5 ms
# a call): from then on calls have to come twice as often, up to a limit, until one is used much more often than that.
# Otherwise many kinds by turns, as of a folder of meshes, would be recorded again and again.
WORTH = 8
WELL_WORTH = 4 * WORTH
MOST_CALLS = 64 * CALLS
MOST_RECORDINGS = 4
# Kinds of calls that are counted.
MOST_KINDS = 64
_REFUSED = -(1 << 62)


class Shelf:
    """The recordings of one device: those used last.

    Args:
        most: Bytes that all of them may take.
        record: Makes a recording of a work and its inputs in some room.
    """

    def __init__(self, most: int, record: Callable[[Room, Work, Inputs], Recording] = Recording) -> None:
        self._most = most
        self._record = record
        self._room = Room()
        self._kept: OrderedDict[Hashable, Recording] = OrderedDict()
        self._calls: OrderedDict[Hashable, int] = OrderedDict()
        self._used: dict[Hashable, int] = {}
        self.needed = CALLS

    def __len__(self) -> int:
        return len(self._kept)

    def find(self, kind: Hashable) -> Recording | None:
        """The recording of a kind of call, if there is one."""
        found = self._kept.get(kind)
        if found is not None:
            self._kept.move_to_end(kind)
            self._used[kind] += 1
            if self._used[kind] == WELL_WORTH:
                self.needed = CALLS
        return found

    def note(self, kind: Hashable, work: Work, inputs: Inputs) -> None:
        """Count a call that went without a recording, and record it if it came often enough."""
        self._calls[kind] = self._calls.pop(kind, 0) + 1
        while len(self._calls) > MOST_KINDS:
            self._calls.popitem(last=False)
        if self._calls[kind] < self.needed or kind in self._kept:
            return
        self._calls[kind] = 0
        while len(self._kept) >= MOST_RECORDINGS:
            oldest = next(iter(self._kept))
            self._regret(self._used[oldest])
            self.drop(oldest)
        try:
            made = self._record(self._room, work, inputs)
        except RuntimeError as error:
            # The call itself has its result.
            self._calls[kind] = _REFUSED
            warnings.warn(f"a call could not be recorded, and will not be replayed: {error}", stacklevel=2)
            return
        if self._room.nbytes <= self._most:
            self._kept[kind], self._used[kind] = made, 0
            return
        if not self._kept:
            self._calls[kind] = _REFUSED
        # Memory of one room goes back together.
        self._regret(min(self._used.values(), default=WORTH))
        self.clear()

    def _regret(self, used: int) -> None:
        """Be slower to record if what has to go was used so little."""
        if used < WORTH:
            self.needed = min(2 * self.needed, MOST_CALLS)

    def drop(self, kind: Hashable) -> None:
        """Forget a recording."""
        self._kept.pop(kind, None)
        self._used.pop(kind, None)
        if not self._kept:
            self.clear()

    def forget(self) -> None:
        """Be as new: no recordings, no calls counted."""
        self.clear()
        self._calls.clear()
        self.needed = CALLS

    def clear(self) -> None:
        """Give up all recordings; those under way go on."""
        self._kept.clear()
        self._used.clear()
        self._room = Room(self._room)
