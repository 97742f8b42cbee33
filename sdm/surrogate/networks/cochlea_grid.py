"""The fixed grid on which every surrogate of the cochlea family answers."""

from __future__ import annotations

from sdm.core.grid import Grid

# 0.2 mm voxels. The family reaches from (-5.44, -5.14, -1.98) to (8.21, 5.80, 4.17) mm over its whole box of
# parameters; at least 0.8 mm of room are left on every side. The counts are multiples of 8, for networks that halve.
ORIGIN_MM = (-6.5, -6.0, -2.8)
SPACING_MM = 0.2
SHAPE = (80, 64, 40)
GRID = Grid(ORIGIN_MM, (SPACING_MM,) * 3, SHAPE)
# The same box in voxels of 0.4 mm, each of eight of the others.
COARSE_GRID = Grid(
    tuple(x + SPACING_MM / 2 for x in ORIGIN_MM), (2 * SPACING_MM,) * 3, tuple(count // 2 for count in SHAPE)
)
