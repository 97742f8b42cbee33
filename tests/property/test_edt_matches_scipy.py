"""The distance transform against SciPy's, and, to voxel faces, against every pair of voxels, in float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from sdm.engine.distance_transform import euclidean_distance_transform
from sdm.kernels.edt import transform as edt

# Weights, their products and two sums are rounded before the root, which halves that; the root, the largest spacing
# and their product after it.
ROUNDINGS = 6 * 2.0**-24
# With few neighbours small volumes have lines that are too far for them, which need envelopes.
NEIGHBOURS = st.sampled_from([1, int(edt.NEIGHBOURS)])
SPACINGS = st.one_of(
    st.just((1.0, 1.0, 1.0)),
    st.tuples(*[st.floats(1 / 64, 64.0, width=32)] * 3),
)


@st.composite
def masks(draw, longest=9):
    shape = draw(st.tuples(*[st.integers(1, longest)] * 3))
    share = draw(st.sampled_from([0.02, 0.2, 0.5, 0.8, 0.98]))
    seed = draw(st.integers(0, 2**32 - 1))
    return np.random.default_rng(seed).random(shape) < share


def to_boxes(mask: np.ndarray, spacing: tuple[float, ...]) -> np.ndarray:
    """From every voxel's centre to the nearest point of the boxes of a mask's voxels."""
    there, everywhere = np.argwhere(mask), np.argwhere(np.ones_like(mask))
    if not len(there):
        return np.full(mask.shape, np.inf)
    steps = np.maximum(np.abs(everywhere[:, None] - there[None]) - 0.5, 0.0) * spacing
    return np.sqrt((steps**2).sum(-1).min(1)).reshape(mask.shape)


def scipy_distance(mask: np.ndarray, spacing: tuple[float, ...]) -> np.ndarray:
    return distance_transform_edt(~mask, spacing) if mask.any() else np.full(mask.shape, np.inf)


def transform(neighbours: int, mask: np.ndarray, spacing: tuple[float, ...], **options) -> np.ndarray:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(edt, "NEIGHBOURS", neighbours)
        return euclidean_distance_transform(torch.tensor(mask), spacing, **options).numpy()


@settings(max_examples=200)
@given(mask=masks(), spacing=SPACINGS, neighbours=NEIGHBOURS)
def test_to_centres(mask, spacing, neighbours):
    values = transform(neighbours, mask, spacing)
    np.testing.assert_allclose(values, scipy_distance(mask, spacing), rtol=ROUNDINGS, atol=0)
    values = transform(neighbours, mask, spacing, signed=True)
    expected = np.where(mask, -scipy_distance(~mask, spacing), scipy_distance(mask, spacing))
    np.testing.assert_allclose(values, expected, rtol=ROUNDINGS, atol=0)


@pytest.fixture(params=[1, 3, 8])
def pieces(request, monkeypatch):
    """So many envelopes a line, as a GPU has."""
    monkeypatch.setitem(edt.PIECES, "cpu", request.param)


@pytest.mark.usefixtures("pieces")
@settings(max_examples=24, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    spacing=SPACINGS,
    surface=st.sampled_from(["centres", "faces"]),
    neighbours=st.sampled_from([1, 4, int(edt.NEIGHBOURS)]),
)
def test_lines_near_and_far(seed, spacing, surface, neighbours):
    """Noise in one box of each volume: some lines are settled among neighbours, some need all their voxels."""
    random = np.random.default_rng(seed)
    mask = np.zeros((2, 14, 22, 30), bool)
    for volume in mask:
        low, high = np.sort(random.integers(0, np.array(volume.shape) + 1, (2, 3)), axis=0)
        box = volume[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
        box[...] = random.random(box.shape) < random.choice([0.1, 0.5, 0.9])
    values = transform(neighbours, mask, spacing, signed=True, surface=surface)
    distance = scipy_distance if surface == "centres" else to_boxes_by_pieces
    expected = np.stack([np.where(m, -distance(~m, spacing), distance(m, spacing)) for m in mask])
    np.testing.assert_allclose(values, expected, rtol=ROUNDINGS, atol=0)


def to_boxes_by_pieces(mask: np.ndarray, spacing: tuple[float, ...]) -> np.ndarray:
    """`to_boxes` for larger masks: axis by axis, every pair of voxels on each line."""
    squared = np.where(mask, 0.0, np.inf)
    for axis, step in enumerate(spacing):
        where = np.arange(mask.shape[axis])
        pairs = (np.maximum(np.abs(where[:, None] - where) - 0.5, 0.0) * step) ** 2
        lines = np.moveaxis(squared, axis, -1)
        squared = np.moveaxis((lines[..., None, :] + pairs).min(-1), -1, axis)
    return np.sqrt(squared)


@settings(max_examples=200)
@given(mask=masks(6), spacing=SPACINGS, neighbours=NEIGHBOURS)
def test_to_faces(mask, spacing, neighbours):
    values = transform(neighbours, mask, spacing, signed=True, surface="faces")
    expected = np.where(mask, -to_boxes(~mask, spacing), to_boxes(mask, spacing))
    np.testing.assert_allclose(values, expected, rtol=ROUNDINGS, atol=0)


@pytest.mark.parametrize("seed", range(6))
def test_larger_volumes(seed, device):
    """Long enough for several words of a GPU's rows, for CPU threads, and for deep envelopes."""
    random = np.random.default_rng(seed)
    shape = (*random.integers(30, 60, 2), random.choice([31, 32, 33, 64, 97]))
    mask = random.random(shape) < [0.5, 0.01, 0.001, 0.9999, 0.0001, 0.99][seed]
    mask[0, 0, 0], mask[-1, -1, -1] = True, False
    spacing = (1.0, 1.0, 1.0) if seed % 2 else tuple(random.uniform(0.1, 4.0, 3))
    values = euclidean_distance_transform(torch.tensor(mask, device=device), spacing, signed=True).cpu().numpy()
    expected = np.where(mask, -scipy_distance(~mask, spacing), scipy_distance(mask, spacing))
    np.testing.assert_allclose(values, expected, rtol=ROUNDINGS, atol=0)
    if spacing == (1.0, 1.0, 1.0):
        # Whole squared distances are exact, so only the root is rounded.
        assert np.array_equal(values, expected.astype(np.float32))
