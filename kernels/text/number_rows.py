"""Lines of decimal numbers to float64, each exactly the nearest one, as `float` gives it.

A decimal number is a whole number times a power of ten. Where the first fits into the 53 bits of a float64 and the
power is at most 10^22, both are exact, and their product or quotient is rounded once (W. Clinger, "How to read floating
point numbers accurately", 1990). Whatever else is met in the text is told, and is for others to read.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from sdm.kernels.launch import launch

wp.set_module_options({"enable_backward": False})

# Kinds of lines in an OBJ file.
OTHER, VERTEX, FACE = 0, 1, 2
# Lines that a thread takes at a time, at least.
SHARE = 4096
LARGEST_EXPONENT = 22
# Digits that 64 bits hold whatever they are.
FEW_DIGITS = 19
POWERS = 10.0 ** np.arange(LARGEST_EXPONENT + 1)
_MANTISSA = wp.uint64(1 << 53)
_TEN = wp.uint64(10)


@wp.func
def is_blank(c: int):
    return c == 32 or (c >= 9 and c <= 13)


@wp.func
def kind_of(text: wp.array(dtype=wp.uint8), at: int, end: int):
    """Kind of the OBJ line whose first letter is at `at`, and where its numbers begin."""
    kind = int(OTHER)
    first = at
    if at < end and int(text[at]) == 118:
        if at + 1 < end and (int(text[at + 1]) == 32 or int(text[at + 1]) == 9):
            kind = VERTEX
            first = at + 1
    elif at < end and int(text[at]) == 102:
        first = at + 1
        if first < end and int(text[first]) == 111:
            first += 1
        if first >= end or is_blank(int(text[first])):
            kind = FACE
    return wp.vec2i(kind, first)


@wp.kernel
def _scan(
    begin: int,
    text: wp.array(dtype=wp.uint8),
    starts: wp.array(dtype=wp.int32),
    obj: int,
    kinds: wp.array(dtype=wp.int32),
    firsts: wp.array(dtype=wp.int32),
    words: wp.array(dtype=wp.int32),
):
    i = begin + wp.tid()
    at = starts[i]
    end = starts[i + 1]
    kind = int(VERTEX)
    if obj == 1:
        while at < end and (int(text[at]) == 32 or int(text[at]) == 9):
            at += 1
        found = kind_of(text, at, end)
        kind = found[0]
        at = found[1]
    count = int(0)
    if kind != OTHER:
        firsts[i] = at
        inside = int(0)
        while at < end:
            c = int(text[at])
            if obj == 1 and c == 35:
                break
            if is_blank(c):
                inside = 0
            elif inside == 0:
                inside = 1
                count += 1
            at += 1
    kinds[i] = kind
    words[i] = count


@wp.func
def decimal(text: wp.array(dtype=wp.uint8), begin: int, end: int):
    """Digits at `begin`, with a point among them: their whole number, its power of ten, how many, and where they end.

    The number says nothing if there are more than `FEW_DIGITS`.
    """
    at = int(begin)
    mantissa = wp.uint64(0)
    going = int(1)
    while at < end and going == 1:
        c = int(text[at])
        if c >= 48 and c <= 57:
            mantissa = mantissa * _TEN + wp.uint64(c - 48)
            at += 1
        else:
            going = 0
    digits = at - begin
    exponent = int(0)
    if at < end and int(text[at]) == 46:
        at += 1
        point = at
        more = int(1)
        while at < end and more == 1:
            c = int(text[at])
            if c >= 48 and c <= 57:
                mantissa = mantissa * _TEN + wp.uint64(c - 48)
                at += 1
            else:
                more = 0
        exponent = point - at
        digits -= exponent
    return mantissa, exponent, digits, at


@wp.func
def long_decimal(text: wp.array(dtype=wp.uint8), begin: int, end: int):
    """The same of any digits, and 1 where 53 bits do not hold them. Zeros at the end of a fraction are left out."""
    at = int(begin)
    mantissa = wp.uint64(0)
    exponent = int(0)
    point = int(0)
    zeros = int(0)
    wrong = int(0)
    going = int(1)
    while at < end and going == 1:
        c = int(text[at])
        if c >= 48 and c <= 57:
            if point == 1 and c == 48:
                # At the end of a fraction they say nothing.
                zeros += 1
            else:
                while zeros > 0 and mantissa < _MANTISSA:
                    mantissa = mantissa * _TEN
                    exponent -= 1
                    zeros -= 1
                # Beyond this it could leave 64 bits.
                if mantissa < _MANTISSA:
                    mantissa = mantissa * _TEN + wp.uint64(c - 48)
                else:
                    wrong = 1
                exponent -= point
            at += 1
        elif c == 46 and point == 0:
            point = 1
            at += 1
        else:
            going = 0
    return mantissa, exponent, wrong


@wp.func
def number(text: wp.array(dtype=wp.uint8), begin: int, end: int, slashes: int, powers: wp.array(dtype=wp.float64)):
    """The word at `begin` as a number, where the word ends, and 1 if it is not a plain one."""
    at = int(begin)
    negative = int(0)
    if int(text[at]) == 45:
        negative = 1
        at += 1
    elif int(text[at]) == 43:
        at += 1
    wrong = int(0)
    first = at
    mantissa, exponent, digits, at = decimal(text, first, end)
    if digits > FEW_DIGITS:
        mantissa, exponent, wrong = long_decimal(text, first, end)
    if digits == 0:
        wrong = 1
    if at < end and (int(text[at]) == 101 or int(text[at]) == 69):
        at += 1
        down = int(0)
        if at < end and int(text[at]) == 45:
            down = 1
            at += 1
        elif at < end and int(text[at]) == 43:
            at += 1
        power = int(0)
        some = int(0)
        going = int(1)
        while at < end and going == 1:
            c = int(text[at])
            if c >= 48 and c <= 57:
                power = wp.min(10 * power + c - 48, 100000)
                some = 1
                at += 1
            else:
                going = 0
        if some == 0:
            wrong = 1
        exponent += wp.where(down == 1, -power, power)
    # What follows the number: nothing, a blank, or in an OBJ file a comment, a texture and a normal.
    if at < end and not is_blank(int(text[at])):
        c = int(text[at])
        if slashes == 1 and c == 47:
            while at < end and not is_blank(int(text[at])) and int(text[at]) != 35:
                at += 1
        elif not (slashes >= 0 and c == 35):
            wrong = 1
            while at < end and not is_blank(int(text[at])):
                at += 1
    # Zeros at its end are of the power.
    while (mantissa > _MANTISSA or exponent < -22) and mantissa > wp.uint64(0) and mantissa % _TEN == wp.uint64(0):
        mantissa = mantissa / _TEN
        exponent += 1
    value = wp.float64(mantissa)
    if mantissa > _MANTISSA:
        wrong = 1
    elif mantissa == wp.uint64(0):
        value = wp.float64(0.0)
    elif exponent < -22 or exponent > 22:
        wrong = 1
    elif exponent < 0:
        value = value / powers[-exponent]
    else:
        value = value * powers[exponent]
    return wp.where(negative == 1, wp.float64(-1.0) * value, value), at, wrong


@wp.kernel
def _parse(
    begin: int,
    text: wp.array(dtype=wp.uint8),
    firsts: wp.array(dtype=wp.int32),
    words: wp.array(dtype=wp.int32),
    offsets: wp.array(dtype=wp.int64),
    slashes: int,
    powers: wp.array(dtype=wp.float64),
    values: wp.array(dtype=wp.float64),
    odd: wp.array(dtype=wp.int32),
):
    i = begin + wp.tid()
    at = firsts[i]
    end = text.shape[0]
    out = offsets[i]
    wrong = int(0)
    for word in range(words[i]):
        while is_blank(int(text[at])):
            at += 1
        value, at, strange = number(text, at, end, slashes, powers)
        wrong = wp.max(wrong, strange)
        values[out + wp.int64(word)] = value
    if wrong == 1:
        odd[0] = 1


@wp.kernel
def _parse_alike(
    begin: int,
    text: wp.array(dtype=wp.uint8),
    firsts: wp.array(dtype=wp.int32),
    ends: wp.array(dtype=wp.int32),
    words: int,
    slashes: int,
    powers: wp.array(dtype=wp.float64),
    values: wp.array2d(dtype=wp.float64),
    odd: wp.array(dtype=wp.int32),
):
    i = begin + wp.tid()
    # One odd line is enough.
    if odd[0] == 1:
        return
    at = firsts[i]
    end = ends[i]
    wrong = int(0)
    for word in range(words):
        while at < end and is_blank(int(text[at])):
            at += 1
        if at >= end or (slashes >= 0 and int(text[at]) == 35):
            wrong = 1
        else:
            value, at, strange = number(text, at, end, slashes, powers)
            wrong = wp.max(wrong, strange)
            values[i, word] = value
    while at < end and is_blank(int(text[at])):
        at += 1
    if at < end and not (slashes >= 0 and int(text[at]) == 35):
        wrong = 1
    if wrong == 1:
        odd[0] = 1


def scan_lines(text: np.ndarray, starts: np.ndarray, *, obj: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Kinds, first places of numbers, and counts of words (L,) int32 each of the lines of a text.

    Args:
        text: (N,) uint8, N below 2^31.
        starts: (L+1,) int32: where each line begins, and where the last one ends. Ends of lines are blanks.
        obj: True for OBJ, whose lines begin with a keyword and end with a comment; else every line is numbers alone.
    """
    count = len(starts) - 1
    kinds, firsts, words = (np.zeros(count, np.int32) for _ in range(3))
    inputs = [_of(text, wp.uint8), _of(starts, wp.int32), int(obj)]
    launch(_scan, count, [*inputs, *(_of(a, wp.int32) for a in (kinds, firsts, words))], "cpu", smallest=SHARE)
    return kinds, firsts, words


def parse_lines(
    text: np.ndarray, firsts: np.ndarray, words: np.ndarray, *, obj: bool, faces: bool = False
) -> np.ndarray | None:
    """The numbers of chosen lines, one after the other, float64; None where one is not as plain as the file says.

    Args:
        text: As for `scan_lines`.
        firsts: (R,) int32 where the numbers of each line begin.
        words: (R,) int32 how many there are.
        obj: As for `scan_lines`.
        faces: True for faces of OBJ, in which textures and normals follow a slash.
    """
    offsets = np.cumsum(words, dtype=np.int64) - words
    values, odd = np.empty(int(words.sum(dtype=np.int64))), np.zeros(1, np.int32)
    slashes = int(faces) if obj else -1
    inputs = [_of(text, wp.uint8), _of(firsts, wp.int32), _of(words, wp.int32), _of(offsets, wp.int64), slashes]
    outputs = [_of(POWERS, wp.float64), _of(values, wp.float64), _of(odd, wp.int32)]
    launch(_parse, len(firsts), [*inputs, *outputs], "cpu", smallest=SHARE)
    return None if odd[0] else values


def parse_alike(
    text: np.ndarray, firsts: np.ndarray, ends: np.ndarray, words: int, *, obj: bool, faces: bool = False
) -> np.ndarray | None:
    """The numbers (R,words) float64 of chosen lines; None where one has more or fewer, or is not plain.

    Args:
        text: As for `scan_lines`.
        firsts: (R,) int32 where the numbers of each line begin.
        ends: (R,) int32 where each line ends.
        words: How many each line has.
        obj: As for `scan_lines`.
        faces: As for `parse_lines`.
    """
    values, odd = np.empty((len(firsts), words)), np.zeros(1, np.int32)
    slashes = int(faces) if obj else -1
    inputs = [_of(text, wp.uint8), _of(firsts, wp.int32), _of(ends, wp.int32), words, slashes]
    outputs = [_of(POWERS, wp.float64), _of(values, wp.float64), _of(odd, wp.int32)]
    launch(_parse_alike, len(firsts), [*inputs, *outputs], "cpu", smallest=SHARE)
    return None if odd[0] else values


def _of(array: np.ndarray, dtype: type) -> wp.array:
    return wp.array(ptr=array.ctypes.data, dtype=dtype, shape=array.shape, device="cpu", copy=False)
