"""Pictures of signed distance maps, of fits, and a window with a map: `from sdm.viz import picture`.

`STYLE` and `colour_map` give figures of your own the same letters, lines and colours.
"""

from sdm.viz.figure import picture
from sdm.viz.style import STYLE, colour_map

__all__ = ["STYLE", "colour_map", "picture"]
