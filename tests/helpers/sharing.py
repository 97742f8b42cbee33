"""The fast path's work shared out on a CPU as a GPU might: what is only a question of speed must not change a map."""

from __future__ import annotations

from typing import Any

import pytest
import warp as wp

from sdm.engine import thick_slices
from sdm.kernels.dense import query


def share_lists(monkeypatch: pytest.MonkeyPatch, shares: int) -> None:
    """As many groups for each list on this CPU as a GPU might have: all that they share is made larger."""
    find = query.find_witnesses

    def shared(*inputs: Any) -> None:
        lists = inputs[3]
        if lists.shares != shares:
            lists.region_shares, lists.shares = 2 * shares, shares
            lists.given = lists.count * (lists.region_shares + 8 * lists.shares)
            for name in ("region_heads", "region_lengths", "heads", "lengths", "nearest"):
                before = getattr(lists, name)
                times = lists.region_shares if name.startswith("region") else shares
                setattr(lists, name, wp.full(times * before.shape[0], -7, dtype=before.dtype, device="cpu"))
        find(*inputs)

    monkeypatch.setattr(query, "find_witnesses", shared)


def leave_levels_out(monkeypatch: pytest.MonkeyPatch, levels: int) -> None:
    """Lists of larger leaves, as long ones have."""
    monkeypatch.setattr(query, "levels_left_out", lambda _triangles, depth, _shape: min(levels, depth))


def slice_lists(monkeypatch: pytest.MonkeyPatch, slice_length: int) -> None:
    monkeypatch.setattr(query, "NO_SLICES", slice_length)


def no_finer_grids(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thick slices measured as they are, as on a GPU."""
    monkeypatch.setattr(thick_slices, "FACTORS", (1,))
