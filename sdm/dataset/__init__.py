"""Datasets of signed distance maps: what a stream yields, frozen into a Zarr 3 folder, and read from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sdm.runtime.lazy_names import lazy_names

if TYPE_CHECKING:
    from sdm.dataset.freezing import freeze
    from sdm.dataset.reader import SDMDataset
    from sdm.dataset.repair import damaged, verify
    from sdm.dataset.writer import generate

# Where each name comes from. A name is imported when it is first used: processes that only write wait for no torch.
_HOMES = {"SDMDataset": "reader", "damaged": "repair", "freeze": "freezing", "generate": "writer", "verify": "repair"}

__all__ = ["SDMDataset", "damaged", "freeze", "generate", "verify"]

__getattr__ = lazy_names(__name__, _HOMES)
