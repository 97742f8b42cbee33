from __future__ import annotations

import random

import numpy as np
import pytest

from sdm.kernels.text.number_rows import FACE, OTHER, VERTEX, parse_alike, parse_lines, scan_lines


def lines_of(text: bytes, *, obj: bool = False):
    data = np.frombuffer(text, np.uint8)
    starts = np.concatenate([[0], np.flatnonzero(data == 10) + 1, [len(data)]]).astype(np.int32)
    return data, *scan_lines(data, starts, obj=obj)


def one(word: str) -> float | None:
    data = np.frombuffer(word.encode(), np.uint8)
    found = parse_lines(data, np.zeros(1, np.int32), np.ones(1, np.int32), obj=False)
    return None if found is None else float(found[0])


def test_numbers_are_the_nearest_ones():
    rng = random.Random(0)
    forms = ("%.6f", "%.8g", "%.12f", "%.3e", "%d.", "%+.5f", "%.15g", "%.0f", "%e", "%.10f")
    words = [
        rng.choice(forms) % rng.choice((rng.random(), -rng.random() * 1e-5, rng.random() * 1e6, rng.randint(0, 10**9)))
        for _ in range(4000)
    ]
    found = [one(word) for word in words]
    assert all(value in (None, float(word)) for word, value in zip(words, found, strict=True))
    # What has too many digits is left to others; it is the exception.
    assert found.count(None) < 0.04 * len(words)


@pytest.mark.parametrize(
    "word",
    ["0", "-0", "+0.0", "000.5", ".5", "5.", "-.25e-2", "1E5", "1e+22", "1e-22", "9007199254740992", "0.000000000000",
     "123456789.250000000000000", "0.00000000000000000000000000"],
)  # fmt: skip
def test_plain_ones(word):
    value = one(word)
    assert value == float(word)
    assert np.signbit(value) == np.signbit(float(word))


@pytest.mark.parametrize(
    "word",
    ["", "-", ".", "e5", "1e", "1e+", "nan", "inf", "0x10", "1_0", "1,5", "1.2.3", "--1", "1-2", "9007199254740993",
     "0.12345678901234567", "1e23", "1e-23", "1/2", "1#2", "1e99999999999"],
)  # fmt: skip
def test_others_are_told(word):
    assert one(word or " -") is None


def test_lines_of_an_obj_file():
    text = (
        b"# v 1\nv 1 2 3 # four\n v\t4 5 6 1\nvn 7 8 9\nf 1/2/3 4//5 6\nfo 1 2 3#x\nfoo 1\nf\n\nv\n\x0bv 1\nusemtl f 1"
    )
    data, kinds, firsts, words = lines_of(text, obj=True)
    assert kinds.tolist() == [OTHER, VERTEX, VERTEX, OTHER, FACE, FACE, OTHER, FACE, OTHER, OTHER, OTHER, OTHER]
    assert words.tolist() == [0, 3, 4, 0, 3, 3, 0, 0, 0, 0, 0, 0]
    chosen = kinds == VERTEX
    assert parse_lines(data, firsts[chosen], words[chosen], obj=True).tolist() == [1, 2, 3, 4, 5, 6, 1]
    chosen = kinds == FACE
    assert parse_lines(data, firsts[chosen], words[chosen], obj=True, faces=True).tolist() == [1, 4, 6, 1, 2, 3]
    assert parse_lines(data, firsts[chosen], words[chosen], obj=True) is None


def test_lines_of_numbers():
    text = b"1 2\n\n\t 3\x0b4 \n5"
    data, kinds, firsts, words = lines_of(text)
    assert words.tolist() == [2, 0, 2, 1]
    assert (kinds == VERTEX).all()
    assert parse_lines(data, firsts, words, obj=False).tolist() == [1, 2, 3, 4, 5]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (b"1 2 3\n4 5 6\n", [[1, 2, 3], [4, 5, 6]]),
        (b"  1 2\t3  \n4 5 -6", [[1, 2, 3], [4, 5, -6]]),
        (b"1 2\n3\n", None),
        (b"1 2 3\n4 5 6 7\n", None),
        (b"1 2 3\n\n", None),
        (b"1 2 3\n4 5 x\n", None),
        (b"1 2 3\n4 5#6\n", None),
    ],
)
def test_lines_alike(text, expected):
    data = np.frombuffer(text, np.uint8)
    ends = np.flatnonzero(np.append(data, 10) == 10).astype(np.int32)[:2]
    firsts = np.array([0, ends[0] + 1], np.int32)
    found = parse_alike(data, firsts, ends, 3, obj=False)
    assert (None if found is None else found.tolist()) == expected


def test_lines_alike_of_an_obj_file():
    data = np.frombuffer(b"1/2/3 4//5 6#7\n1 2 3 # 4\n", np.uint8)
    firsts, ends = np.array([0, 15], np.int32), np.array([15, 25], np.int32)
    found = parse_alike(data, firsts, ends, 3, obj=True, faces=True)
    assert found is not None
    assert found.tolist() == [[1, 4, 6], [1, 2, 3]]
    assert parse_alike(data, firsts, ends, 3, obj=True) is None
