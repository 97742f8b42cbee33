"""Datasets of signed distance maps: what a stream yields, frozen into a Zarr 3 folder, and read from it."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sdm.dataset.freezing import freeze
    from sdm.dataset.reader import SDMDataset
    from sdm.dataset.repair import damaged, verify
    from sdm.dataset.writer import generate

# Where each name comes from. A name is imported when it is first used: processes that only write wait for no torch.
_HOMES = {"SDMDataset": "reader", "damaged": "repair", "freeze": "freezing", "generate": "writer", "verify": "repair"}

__all__ = ["SDMDataset", "damaged", "freeze", "generate", "verify"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'sdm.dataset' has no attribute {name!r}")
    value = getattr(import_module(f"sdm.dataset.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
