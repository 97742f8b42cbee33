"""A page in the browser with shapes that follow sliders: `from sdm.explore import explore`. By viser, an extra."""

from sdm.explore.session import explore

__all__ = ["explore"]
