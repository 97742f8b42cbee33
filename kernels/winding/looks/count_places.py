"""Places of the counts that the kernels share which open an open mesh's caps."""

from __future__ import annotations

# Boxes of 2^5 voxels along each edge, and so on; single voxels twice.
BITS = (5, 4, 3, 2, 1, 0, 0)
# For each level, and for the sums over all edges: which box is next, how many there are, and how many of their octants,
# or voxels, were looked at; how many records of boxes there are, and caps near them, and which of them is next; how
# many boxes of twice the size are around boxes.
NEXT, LENGTH, LOOKED, RECORDED, RECORDED_NEAR, NEXT_RECORD, AROUND, STRIDE = 0, 1, 2, 3, 4, 5, 6, 7
EXACT = STRIDE * len(BITS) + LOOKED
ALONE = BITS.index(0)
# Voxels that wait for sums over all caps, which of them is next, and which of those for the sum in float64.
UNSURE, NEXT_UNSURE, NEXT_EXACT = EXACT + 1, EXACT + 2, EXACT + 3
COUNTS = NEXT_EXACT + 1
