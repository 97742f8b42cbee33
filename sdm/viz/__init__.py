"""Pictures of signed distance maps, of fits, and a window with a map: `from sdm.viz import picture`."""

from sdm.viz.figure import picture

__all__ = ["picture"]
