"""Interface of work that several devices share, in numbered shards."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Protocol

from sdm.runtime.pipeline.stage_times import StageTimes


class SharedJob(Protocol):
    """All that a process needs to know to do any shard of the work. It is pickled to get there."""

    def absolute(self) -> SharedJob:
        """The same, with paths that hold in any working folder."""
        ...

    def check(self) -> None:
        """See that this machine has what the work needs.

        Raises:
            SDMError: It has not, in a sentence.
        """
        ...

    def maker(self, device: str) -> Any:
        """Tools of `run` on a device, made once in each process."""
        ...

    def run(
        self, shards: Iterable[int], maker: Any, done: Callable[[Any], None], *, times: StageTimes | None = None
    ) -> None:
        """Do shards, and tell of each once when it is done; the next one is asked for before that.

        Raises:
            SDMError: The work cannot go on.
        """
        ...

    def agree(self, kind: str) -> None:
        """Take notice of the kind of a device that will work. Called by who shares the work out.

        Raises:
            SDMError: Devices of this kind are not to be mixed with those before.
        """
        ...
