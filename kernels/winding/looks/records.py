"""Boxes of voxels that have been looked at, and wait for their voxels to be settled: fields and near caps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from sdm.kernels.launch import set_array
from sdm.kernels.primitives.atomics import fetch_add
from sdm.kernels.primitives.lanes import int_from_lane
from sdm.kernels.primitives.vector_loads import load4, write4
from sdm.kernels.winding.cap_field import Field

wp.set_module_options({"enable_backward": False})

# Numbers of a box's field, and whole numbers: the box's, how many caps are near, and the place of the first of them.
FIELD_SIZE = 20
ROW = 4
_FOURS = FIELD_SIZE // 4


@wp.struct
class Records:
    """Boxes that have been looked at; how many, and how many near caps, is among the counts."""

    fields: wp.array(dtype=wp.float32)  # (N * FIELD_SIZE)
    rows: wp.array(dtype=wp.int32)  # (N * ROW)
    near: wp.array(dtype=wp.int32)  # places of near caps, or nodes, of one box after the other
    middles: wp.array(dtype=wp.float32)  # (N * 4) what fields are about, where that is not the middle of the box


@wp.func
def write_field(records: Records, slot: int, f: Field):
    at = _FOURS * slot
    write4(records.fields, at, float(f.value), f.slope[0], f.slope[1], f.slope[2])
    write4(records.fields, at + 1, f.squares[0], f.squares[1], f.squares[2], f.products[0])
    write4(records.fields, at + 2, f.products[1], f.products[2], f.cubes[0], f.cubes[1])
    write4(records.fields, at + 3, f.cubes[2], f.cubes[3], f.cubes[4], f.cubes[5])
    write4(records.fields, at + 4, f.cubes[6], f.error, float(f.value - wp.float64(float(f.value))), 0.0)


@wp.func
def read_field(records: Records, slot: int):
    """A record's field, with the number of caps that are near."""
    at = _FOURS * slot
    r0 = load4(records.fields, at)
    r1 = load4(records.fields, at + 1)
    r2 = load4(records.fields, at + 2)
    r3 = load4(records.fields, at + 3)
    r4 = load4(records.fields, at + 4)
    f = Field()
    f.value = wp.float64(r0[0]) + wp.float64(r4[2])
    f.slope = wp.vec3(r0[1], r0[2], r0[3])
    f.squares = wp.vec3(r1[0], r1[1], r1[2])
    f.products = wp.vec3(r1[3], r2[0], r2[1])
    f.cubes[0] = r2[2]
    f.cubes[1] = r2[3]
    f.cubes[2] = r3[0]
    f.cubes[3] = r3[1]
    f.cubes[4] = r3[2]
    f.cubes[5] = r3[3]
    f.cubes[6] = r4[0]
    f.error = r4[1]
    f.near = records.rows[ROW * slot + 1]
    return f


@wp.func_native(snippet="reinterpret_cast<float*>(stack.data)[at] = value;")
def put_number(stack: wp.array(dtype=wp.int32), at: int, value: float):
    """Write a number to a place of a stack."""
    ...


@wp.func_native(snippet="return reinterpret_cast<const float*>(stack.data)[at];")
def number_at(stack: wp.array(dtype=wp.int32), at: int) -> float:
    """A number that was written to a place of a stack."""
    ...


@wp.func
def put_field(stack: wp.array(dtype=wp.int32), at: int, f: Field):
    """Write a field to a stack, to FIELD_SIZE places: what is not needed for long has no place in registers."""
    high = float(f.value)
    put_number(stack, at, high)
    put_number(stack, at + 1, float(f.value - wp.float64(high)))
    put_number(stack, at + 2, f.error)
    put_number(stack, at + 3, f.drift)
    for axis in range(3):
        put_number(stack, at + 4 + axis, f.slope[axis])
        put_number(stack, at + 7 + axis, f.squares[axis])
        put_number(stack, at + 10 + axis, f.products[axis])
    for number in range(7):
        put_number(stack, at + 13 + number, f.cubes[number])


@wp.func
def field_at(stack: wp.array(dtype=wp.int32), at: int):
    """A field that was written to a stack, without what is near."""
    f = Field()
    f.value = wp.float64(number_at(stack, at)) + wp.float64(number_at(stack, at + 1))
    f.error = number_at(stack, at + 2)
    f.drift = number_at(stack, at + 3)
    for axis in range(3):
        f.slope[axis] = number_at(stack, at + 4 + axis)
        f.squares[axis] = number_at(stack, at + 7 + axis)
        f.products[axis] = number_at(stack, at + 10 + axis)
    for number in range(7):
        f.cubes[number] = number_at(stack, at + 13 + number)
    return f


@wp.func
def put_record(
    records: Records,
    counts: wp.array(dtype=wp.int32),
    length: int,
    length_near: int,
    wanted: bool,
    number: int,
    field: Field,
    stack: wp.array(dtype=wp.int32),
    at: int,
    lane: int,
    some: int,
):
    """Write what a part of a group, of so many neighbouring lanes, has found about a box; true if there was room.

    All lanes have to ask, some of them for nothing. The near caps are listed on the stack. `length` and `length_near`
    are places of the counts: of records and of near caps.
    """
    mine = lane & (some - 1)
    slot = int(-1)
    place = int(0)
    if wanted and mine == 0:
        slot = fetch_add(counts, length, 1)
        place = fetch_add(counts, length_near, field.near)
        if slot >= records.rows.shape[0] / ROW:
            slot = int(-1)
        elif place + field.near > records.near.shape[0]:
            # Nobody looks at it.
            records.rows[ROW * slot] = -1
            slot = int(-1)
        else:
            write_field(records, slot, field)
            records.rows[ROW * slot] = number
            records.rows[ROW * slot + 1] = field.near
            records.rows[ROW * slot + 2] = place
    slot = int_from_lane(slot, lane - mine)
    place = int_from_lane(place, lane - mine)
    if slot >= 0:
        i = mine
        while i < field.near:
            records.near[place + i] = stack[at + i]
            i = i + some
    return slot >= 0


def new_records(boxes: int, near: int, empty: Callable[[int, Any], wp.array]) -> Records:
    """Room for so many boxes, and near caps of all of them. `empty(length, dtype)` allocates workspace."""
    records = Records()
    set_array(records, "fields", empty(boxes * FIELD_SIZE, wp.float32))
    set_array(records, "rows", empty(boxes * ROW, wp.int32))
    set_array(records, "near", empty(near, wp.int32))
    set_array(records, "middles", empty(4 * boxes, wp.float32))
    return records
