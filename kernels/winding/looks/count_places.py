"""Places of the counts that the kernels share which open an open mesh's caps."""

from __future__ import annotations

# Boxes of 2^5 voxels along each edge, and so on; single voxels twice.
BITS = (5, 4, 3, 2, 1, 0, 0)
# For each level, and for the sums over all edges: which box is next, how many there are, and how many of their octants,
# or voxels, were looked at; how many records of boxes there are, and caps near them, and which of them is next.
NEXT, LENGTH, LOOKED, RECORDED, RECORDED_NEAR, NEXT_RECORD, STRIDE = 0, 1, 2, 3, 4, 5, 6
EXACT = STRIDE * len(BITS) + LOOKED
ALONE = BITS.index(0)
# Voxels that wait for sums over all caps, and which of them is next.
UNSURE, NEXT_UNSURE = EXACT + 1, EXACT + 2
COUNTS = NEXT_UNSURE + 1
