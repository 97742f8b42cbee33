"""A look at what the dense query's stages have made before its blocks are measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from sdm.kernels.dense import query
from sdm.kernels.dense.workspace import CHUNK, NEXT_CHUNK


@contextmanager
def watching(look: Callable[[Any], None]) -> Iterator[None]:
    """Call `look(lists)` in every pass, after stage 5 and before stage 6."""
    measure = query.measure_blocks

    def spy(*inputs: Any) -> None:
        look(inputs[3])
        measure(*inputs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(query, "measure_blocks", spy)
        yield


def entries_used(lists: Any) -> int:
    """Entries of the pool that a pass has taken, or would have if there were as many."""
    return int(CHUNK * (lists.given + lists.counts.numpy()[NEXT_CHUNK]))
