"""Mesh inspection: closed, oriented, outward, manifold, and the problems found."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sdm.inspect.outward import orient_outward
    from sdm.inspect.report import MeshReport, inspect_mesh

# Where each name comes from. A name is imported when it is first used: processes that only read wait for no torch.
_HOMES = {"MeshReport": "report", "inspect_mesh": "report", "orient_outward": "outward"}

__all__ = ["MeshReport", "inspect_mesh", "orient_outward"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'sdm.inspect' has no attribute {name!r}")
    value = getattr(import_module(f"sdm.inspect.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
