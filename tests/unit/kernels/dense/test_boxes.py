"""Octants and eighths of features, and the queues that they wait in."""
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false, reportOperatorIssue=false

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from sdm.kernels.dense.block.feature_setup import kind_of, next_batch
from sdm.kernels.dense.block.min_values import two_at, values_of
from sdm.kernels.dense.block.octant_tests import eighths_of, octants_of
from sdm.kernels.dense.block.shared_layout import (
    BATCH,
    ITEMS,
    LATTICE_ROW,
    MIN_VALUES,
    SCRATCH_ROWS,
    TEST_ROW,
    scratch_of,
    write_row,
)
from sdm.kernels.primitives.work_queues import FEATURE_BITS, enqueue, queue_entry

wp.set_module_options({"enable_backward": False})

MIN_VALUES_ROW, MIN_VALUES_ROWS = MIN_VALUES // 4, 128


@wp.kernel
def _boxes(
    memory: wp.array(dtype=float),
    lattice: wp.array(dtype=wp.vec3),
    tests: wp.array2d(dtype=wp.vec4),
    pairs: wp.array(dtype=int),
    octants: wp.array(dtype=int),
    eighths: wp.array(dtype=int),
):
    scratch = scratch_of(memory, 0)
    for row in range(4):
        at = lattice[row]
        write_row(scratch, LATTICE_ROW + row, at[0], at[1], at[2], 0.0)
    for i in range(pairs.shape[0]):
        feature = pairs[i] % BATCH
        for t in range(tests.shape[1]):
            u = tests[i, t]
            write_row(scratch, TEST_ROW + BATCH * t + feature, u[0], u[1], u[2], u[3])
        octants[i] = octants_of(scratch, feature, tests.shape[1])
        eighths[i] = 0
        if octants[i] != 0:
            eighths[i] = eighths_of(scratch, pairs[i], tests.shape[1])


def boxes(lattice: np.ndarray, tests: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    memory = wp.zeros(4 * SCRATCH_ROWS, dtype=float, device="cpu")
    octants, eighths = (wp.zeros(len(pairs), dtype=int, device="cpu") for _ in range(2))
    given = wp.array(tests.astype(np.float32), dtype=wp.vec4, ndim=2, device="cpu")
    rows = wp.array(lattice.astype(np.float32), dtype=wp.vec3, device="cpu")
    inputs = [memory, rows, given, wp.array(pairs, dtype=int, device="cpu"), octants, eighths]
    wp.launch(_boxes, 1, inputs, device="cpu")
    return octants.numpy(), eighths.numpy()


def kept_boxes(lattice: np.ndarray, tests: np.ndarray, first: np.ndarray, size: int) -> tuple[int, int]:
    """Bit masks of the eight boxes of size^3 voxels that pass all tests, and of those not near a limit.

    A linear function is least at one of a box's corners.
    """
    kept = clear = 0
    for box in range(8):
        low = first + size * np.array([box >> 2 & 1, box >> 1 & 1, box & 1])
        corners = np.array([low + (size - 1) * np.array(c) for c in np.ndindex(2, 2, 2)])
        at = lattice[0] + corners @ lattice[1:]
        gap = tests[:, 3] - (at @ tests[:, :3].T).min(0)
        kept |= int((gap > 0).all()) << box
        clear |= int(np.abs(gap).min() > 1e-4) << box
    return kept, clear


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("count", [6, 5, 4])
def test_a_box_is_kept_where_a_point_of_it_passes_all_tests(count, turned):
    rng = np.random.default_rng(10 * count + turned)
    trials = 300
    steps = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turned else np.diag([1.0, 0.8, 1.3])
    lattice = np.concatenate([-3.5 * steps.sum(0)[None], steps]).astype(np.float32).astype(np.float64)
    tests = np.concatenate([rng.normal(size=(trials, count, 3)), rng.uniform(-6, 8, (trials, count, 1))], 2)
    tests = tests.astype(np.float32).astype(np.float64)
    octant = rng.integers(0, 8, trials)
    pairs = (rng.integers(0, BATCH, trials) + BATCH * octant).astype(np.int32)
    octants, eighths = boxes(lattice, tests, pairs)
    some = 0
    for i in range(trials):
        kept, clear = kept_boxes(lattice, tests[i], np.zeros(3), 4)
        assert octants[i] & clear == kept & clear
        if octants[i] == 0:
            continue
        first = 4 * np.array([octant[i] >> 2 & 1, octant[i] >> 1 & 1, octant[i] & 1])
        kept, clear = kept_boxes(lattice, tests[i], first, 2)
        assert eighths[i] & clear == kept & clear
        some += 0 < kept < 255
    assert some > 10


@wp.kernel
def _queue(begin: int, memory: wp.array(dtype=float), which: wp.array(dtype=int), out: wp.array(dtype=int)):
    scratch = scratch_of(memory, 0)
    top = int(begin)
    for feature in range(which.shape[0]):
        top = enqueue(scratch, ITEMS, top, feature, FEATURE_BITS, which[feature], 0)
    for i in range(top):
        out[i] = queue_entry(scratch, ITEMS, i)
    out[out.shape[0] - 1] = top


def test_queues_hold_what_was_put_in():
    rng = np.random.default_rng(0)
    which = rng.integers(0, 256, 24)
    out = wp.zeros(400, dtype=int, device="cpu")
    memory = wp.zeros(4 * SCRATCH_ROWS, dtype=float, device="cpu")
    wp.launch(_queue, 1, [0, memory, wp.array(which, dtype=int, device="cpu"), out], device="cpu")
    wanted = [feature | box << FEATURE_BITS for feature in range(24) for box in range(8) if which[feature] >> box & 1]
    found = out.numpy()
    assert found[-1] == len(wanted)
    assert list(found[: len(wanted)]) == wanted


@wp.kernel
def _batches(counts: wp.array(dtype=wp.vec3i), lanes: int, out: wp.array2d(dtype=int)):
    i = wp.tid()
    batch = next_batch(counts[i][0], counts[i][1], counts[i][2], lanes)
    for feature in range(lanes):
        out[i, feature] = -1
        if feature < batch.features:
            out[i, feature] = kind_of(batch, feature)


def test_features_are_taken_once_and_full_lanes_first():
    """Repeating what is taken empties all three lists; features of one kind that fill the lanes are by themselves."""
    rng = np.random.default_rng(1)
    left = rng.integers(0, 63, (300, 3))
    for _ in range(8):
        busy = left.sum(1) > 0
        out = wp.zeros((300, 32), dtype=int, device="cpu")
        wp.launch(_batches, 300, [wp.array(left, dtype=wp.vec3i, device="cpu"), 32, out], device="cpu")
        kinds = out.numpy()
        taken = np.stack([(kinds == kind).sum(1) for kind in range(3)], 1)
        assert (taken <= left).all()
        assert (taken[busy].sum(1) > 0).all()
        full = (left >= 32).any(1)
        assert (np.sort(taken[full], 1) == [0, 0, 32]).all()
        few = busy & (left.sum(1) <= 32)
        assert (taken[few] == left[few]).all()
        left = left - taken
    assert not left.any()


@wp.kernel
def _twos(memory: wp.array(dtype=float), at: wp.array(dtype=wp.vec3i), values: wp.array(dtype=wp.vec2)):
    scratch = scratch_of(memory, 0)
    for row in range(MIN_VALUES_ROWS):
        first = float(4 * row)
        write_row(scratch, MIN_VALUES_ROW + row, first, first + 1.0, first + 2.0, first + 3.0)
    for two in range(at.shape[0]):
        at[two] = two_at(two)
        values[two] = values_of(scratch, two)


def test_values_stand_octant_by_octant_and_eighth_by_eighth():
    at = wp.zeros(256, dtype=wp.vec3i, device="cpu")
    values = wp.zeros(256, dtype=wp.vec2, device="cpu")
    wp.launch(_twos, 1, [wp.zeros(4 * SCRATCH_ROWS, dtype=float, device="cpu"), at, values], device="cpu")
    voxels = (at.numpy()[:, None] + [[0, 0, 0], [0, 0, 1]]).reshape(-1, 3)
    assert len(np.unique(voxels, axis=0)) == 512
    assert (voxels[:64].max(0) == 3).all()  # a block of 4^3 voxels has the first 32 twos
    octant, eighth, corner = ((voxels >> bit & 1) @ [4, 2, 1] for bit in (2, 1, 0))
    assert (values.numpy().reshape(-1) == 64 * octant + 8 * eighth + corner).all()
