"""NumPy archives by few writes: the bytes of numpy.savez."""

import io

import numpy as np
import pytest

from sdm.io.files import npz_archive
from sdm.io.files.npz_archive import LARGE, write_archive

LARGE_ARRAY = np.arange(LARGE, dtype=np.float32).reshape(4, -1, 16)
ARRAYS = [
    {"values": LARGE_ARRAY, "origin": np.zeros(3), "version": np.asarray(1), "made_from": np.asarray("a" * 32)},
    {
        "a": np.zeros(2),
        "values": LARGE_ARRAY,
        "b": np.ones((2, 2), np.int32),
        "more": (LARGE_ARRAY / LARGE).astype(np.float16),
    },
    {"values": LARGE_ARRAY.transpose(2, 0, 1)},
    {"values": LARGE_ARRAY[::2]},
    {"empty": np.zeros((0, 3), np.float32)},
    {
        "größe": np.zeros(2),
        "naïve": np.asarray("é"),
        "scalar": np.float64(2.0) * np.ones(()),
        "bools": np.ones(3, bool),
    },
    {"turned": np.asfortranarray(np.ones((3, 4))), "swapped": np.arange(4, dtype=">i4")},
    {"just": np.zeros(LARGE, np.uint8), "below": np.zeros(LARGE - 1, np.uint8)},
]


@pytest.mark.parametrize("arrays", ARRAYS)
def test_bytes_are_those_of_numpy(arrays: dict[str, np.ndarray]) -> None:
    expected, found = io.BytesIO(), io.BytesIO()
    np.savez(expected, **arrays)
    write_archive(found, arrays)
    assert found.getvalue() == expected.getvalue()


def test_what_needs_longer_fields_is_left_to_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(npz_archive, "MOST_BYTES", 1000)
    test_bytes_are_those_of_numpy(ARRAYS[0])


def test_few_writes() -> None:
    class Counted(io.BytesIO):
        writes = 0

        def write(self, data: object) -> int:
            Counted.writes += 1
            return super().write(data)  # type: ignore[arg-type]

    write_archive(Counted(), ARRAYS[0])
    # Headers, values, and all the rest.
    assert Counted.writes == 3
