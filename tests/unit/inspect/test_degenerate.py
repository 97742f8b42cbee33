from __future__ import annotations

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sdm.inspect.degenerate import zero_area


def rational(corners: np.ndarray) -> bool:
    a, b, c = ([Fraction(float(x)) for x in corner] for corner in corners)
    p, q = [x - y for x, y in zip(b, a, strict=True)], [x - y for x, y in zip(c, a, strict=True)]
    return all(p[i] * q[j] == p[j] * q[i] for i, j in ((0, 1), (1, 2), (2, 0)))


NUMBERS = st.one_of(
    st.sampled_from([float(np.float32(x)) for x in (0, 1, -1, 0.1, 1e-20, 1e20, 1e30, 1e-45, 2**24)]),
    st.floats(-2.0, 2.0, width=32),
    st.floats(-(2.0**100), 2.0**100, width=32),
)


@given(arrays(np.float32, (4, 3, 3), elements=NUMBERS))
def test_it_is_what_rational_numbers_say(corners):
    assert zero_area(corners).tolist() == [rational(triangle) for triangle in corners]


@given(arrays(np.float32, (3,), elements=NUMBERS), arrays(np.float32, (3,), elements=NUMBERS), st.integers(-20, 20))
def test_points_on_a_line(start, step, power):
    with np.errstate(over="ignore"):
        corners = np.stack([start, start + step, start + step * np.float32(2.0**power)])
    corners = np.nan_to_num(corners, posinf=1e30, neginf=-1e30)[None].astype(np.float32)
    assert zero_area(corners)[0] == rational(corners[0])


def test_slivers_are_told_from_lines():
    line = np.array([[0, 0, 0], [1, 1, 1], [3, 3, 3]], np.float32) * np.float32(0.1)
    moved = line.copy()
    moved[1, 2] = np.nextafter(moved[1, 2], np.float32(1))
    assert zero_area(np.stack([line * 1, moved])).tolist() == [rational(line), False]
    exact = np.array([[0, 0, 0], [1, 2, 3], [2, 4, 6]], np.float32)
    assert zero_area(np.stack([exact, exact + 1, exact * np.float32(1e-30)])).all()


def test_many_at_once():
    flat = np.zeros((200_000, 3, 3), np.float32)
    flat[:, 1, 0], flat[:, 2, 0] = 1, 2
    assert zero_area(flat).all()
    flat[:, 2, 1] = 1e-30
    assert not zero_area(flat).any()
