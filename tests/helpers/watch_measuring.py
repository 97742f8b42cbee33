"""A look at what the dense query's stages have made before its blocks are measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from sdm.kernels.dense import query
from sdm.kernels.dense.chunk_pool import CHUNK
from sdm.kernels.dense.counters import NEXT_CHUNK
from sdm.kernels.dense.workspace import Workspace


@contextmanager
def watching(look: Callable[[Workspace], None]) -> Iterator[None]:
    """Call `look(workspace)` in every pass, after stage 5 and before stage 6."""
    make, measure = query.make_workspace, query.measure_blocks
    made: list[Workspace] = []

    def note(*inputs: Any) -> Workspace:
        made[:] = [make(*inputs)]
        return made[0]

    def spy(*inputs: Any) -> None:
        look(made[0])
        measure(*inputs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(query, "make_workspace", note)
        patch.setattr(query, "measure_blocks", spy)
        yield


def entries_used(work: Workspace) -> int:
    """Entries of the pool that a pass has taken, or would have if there were as many."""
    return int(CHUNK * (work.pool.reserved + work.counters.numpy()[NEXT_CHUNK]))
