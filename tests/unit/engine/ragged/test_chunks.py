"""Chunks hold as many items as their bounds allow, and at least one."""

from __future__ import annotations

from sdm.engine.ragged import chunks
from sdm.engine.ragged.chunks import TRIANGLE_BYTES, VOXEL_BYTES, in_chunks, voxels_of


def sizes(loads: list[tuple[int, int]], most: int) -> list[int]:
    return [len(chunk) for chunk in in_chunks(loads, lambda load: load, lambda _: most)]


def test_bytes_bound_a_chunk():
    loads = [(10, 64)] * 7
    each = 10 * TRIANGLE_BYTES + 64 * VOXEL_BYTES
    assert sizes(loads, 3 * each) == [3, 3, 1]
    assert sizes(loads, 3 * each - 1) == [2, 2, 2, 1]
    assert sizes(loads, 1) == [1] * 7
    assert sizes([], 1) == []


def test_a_large_one_is_alone():
    loads = [(10, 0), (10, 0), (10**6, 0), (10, 0)]
    assert sizes(loads, 1000 * TRIANGLE_BYTES) == [2, 1, 1]


def test_numbers_stay_within_32_bits():
    assert sizes([(chunks.MOST_TRIANGLES // 2, 0)] * 3, 1 << 60) == [2, 1]
    assert sizes([(1, chunks.MOST_VOXELS // 2)] * 3, 1 << 60) == [2, 1]
    assert sizes([(1, 0)] * (chunks.MOST_MESHES + 1), 1 << 60) == [chunks.MOST_MESHES, 1]


def test_maps_begin_at_multiples_of_256_bytes():
    assert [voxels_of(shape) for shape in ((1, 1, 1), (4, 4, 4), (5, 5, 5))] == [64, 64, 128]
