"""Versions of the manifest, and what came with each."""

from __future__ import annotations

VERSION = 3
# From this version on, the manifest has a checksum of itself, and every array but the shards' own checksums one of each
# chunk.
WITH_CHECKSUMS = 2
# From this version on, maps are compressed in larger blocks: fewer bytes, in two thirds of the time and read in half.
LARGE_BLOCKS = 3
