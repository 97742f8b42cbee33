"""Mesh inspection: closed, oriented, outward, manifold, and the problems found."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sdm.runtime.lazy_names import lazy_names

if TYPE_CHECKING:
    from sdm.inspect.outward import orient_outward
    from sdm.inspect.report import MeshReport, inspect_mesh

# Where each name comes from. A name is imported when it is first used: processes that only read wait for no torch.
_HOMES = {"MeshReport": "report", "inspect_mesh": "report", "orient_outward": "outward"}

__all__ = ["MeshReport", "inspect_mesh", "orient_outward"]

__getattr__ = lazy_names(__name__, _HOMES)
