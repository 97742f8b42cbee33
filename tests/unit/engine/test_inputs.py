"""Whatever holds numbers may be given: the values are those of the same numbers in float32."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import torus

VERTICES, FACES = torus(256)
POINTS = np.random.default_rng(0).uniform(-1, 1, (40, 3)).astype(np.float32)


class Foreign:
    """An array of some other library: all it has is DLPack."""

    def __init__(self, array: np.ndarray) -> None:
        self._array = array

    def __dlpack__(self, **options: object) -> object:
        return self._array.__dlpack__(**options)  # type: ignore[arg-type]

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._array.__dlpack_device__()


def _read_only(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array.flags.writeable = False
    return array


def _with_gaps(array: np.ndarray) -> np.ndarray:
    wide = np.full((2 * len(array), 7), 99, array.dtype)
    wide[::2, 1:6:2] = array
    return wide[::2, 1:6:2]


def _packed(array: np.ndarray) -> np.ndarray:
    records = np.zeros(len(array), [("count", "u1"), ("row", array.dtype, array.shape[1:])])
    records["row"] = array
    return records["row"]


FORMS = {
    "float64": lambda a: a.astype(np.float64),
    "big-endian": lambda a: a.astype(a.dtype.newbyteorder(">")),
    "with gaps": _with_gaps,
    "backwards": lambda a: np.ascontiguousarray(a[::-1, ::-1])[::-1, ::-1],
    "column-major": np.asfortranarray,
    "read-only": _read_only,
    "packed records": _packed,
    "long double": lambda a: a.astype(np.longdouble),
    "list": lambda a: a.tolist(),
    "tuples": lambda a: tuple(map(tuple, a.tolist())),
    "torch": torch.tensor,
    "torch float64": lambda a: torch.tensor(a).double(),
    "torch transposed": lambda a: torch.tensor(np.ascontiguousarray(a.T)).T,
    "DLPack": Foreign,
}


@pytest.fixture(scope="module")
def expected():
    return sdm.signed_distance(sdm.TriangleMesh(VERTICES, FACES), POINTS, device="cpu")


@pytest.mark.parametrize("form", FORMS)
def test_points_and_vertices(expected, form):
    vertices, points = FORMS[form](VERTICES), FORMS[form](POINTS)
    values = sdm.signed_distance(sdm.TriangleMesh(vertices, FACES), points, device="cpu")
    assert values.dtype == torch.float32
    assert torch.equal(values, expected)
    index = sdm.MeshIndex(sdm.TriangleMesh(VERTICES * 2, FACES), "cpu")
    index.update(vertices)
    assert torch.equal(index.signed_distance(points), expected)


def test_half_precision():
    points = POINTS.astype(np.float16)
    mesh = sdm.TriangleMesh(VERTICES, FACES)
    exact = sdm.signed_distance(mesh, points.astype(np.float32), device="cpu")
    assert torch.equal(sdm.signed_distance(mesh, points, device="cpu"), exact)
    assert torch.equal(sdm.signed_distance(mesh, torch.tensor(points), device="cpu"), exact)


@pytest.mark.parametrize("dtype", [np.int64, np.uint32, np.uint16, np.uint64, np.int16, ">i4"])
def test_faces(expected, dtype):
    mesh = sdm.TriangleMesh(VERTICES, FACES.astype(dtype))
    assert mesh.faces.dtype == torch.int32
    assert torch.equal(sdm.signed_distance(mesh, POINTS, device="cpu"), expected)
    grid = sdm.Grid([0, 0, 0], [1, 1, 1], [2, 2, 2])
    maps = sdm.signed_distance_maps(VERTICES[None], FACES.astype(dtype), grid, device="cpu")
    assert torch.equal(maps, sdm.signed_distance_maps(VERTICES[None], FACES, grid, device="cpu"))


@pytest.mark.parametrize("form", FORMS)
def test_batches(form):
    grid = sdm.Grid([-1, -1, -1], [0.5, 0.5, 0.5], [5, 5, 5])
    expected = sdm.signed_distance_maps(np.stack([VERTICES, VERTICES]), FACES, grid, device="cpu")
    if form == "torch transposed":
        given = torch.tensor(np.stack([VERTICES.T, VERTICES.T])).transpose(1, 2)
    elif form == "with gaps":
        given = np.stack([VERTICES, VERTICES, VERTICES])[::2]
    else:
        given = FORMS[form](np.stack([VERTICES, VERTICES]))
    assert torch.equal(sdm.signed_distance_maps(given, FACES, grid, device="cpu"), expected)


@pytest.mark.parametrize("shape", [(), (1,), (40,), (8, 5), (2, 4, 5), (0,), (3, 0, 2)])
def test_points_of_any_shape(expected, shape):
    """(..., 3) in, (...) out, closest points and winding numbers too."""
    count = int(np.prod(shape))
    points = POINTS[:count].reshape(*shape, 3)
    index = sdm.MeshIndex(sdm.TriangleMesh(VERTICES, FACES), "cpu")
    values, hit = index.signed_distance(points, return_closest=True)
    assert values.shape == shape
    assert torch.equal(values, expected[:count].reshape(shape))
    assert torch.equal(index.signed_distance(points), values)
    assert hit.points.shape == (*shape, 3)
    assert hit.faces.shape == shape
    assert hit.faces.dtype == torch.int32
    assert hit.barycentric.shape == (*shape, 3)
    assert index.winding_number(points).shape == shape


def test_points_that_are_not_finite():
    """NaN, face -1; the points beside them are measured as ever."""
    points = np.array([[0, 0, 0], [np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf], [1, 2, 3]])
    index = sdm.MeshIndex(sdm.TriangleMesh(VERTICES, FACES), "cpu")
    values, hit = index.signed_distance(points, return_closest=True)
    assert values.isnan().tolist() == [False, True, True, True, False]
    assert torch.equal(values.isnan(), index.signed_distance(points).isnan())
    assert torch.equal(values.isnan(), index.winding_number(points).isnan())
    assert (hit.faces >= 0).tolist() == [True, False, False, False, True]
    assert hit.faces[1] == -1
    assert hit.points[1].isnan().all()
    assert hit.barycentric[1].isnan().all()


def test_many_points_some_not_finite():
    """So many that they are sorted first."""
    rng = np.random.default_rng(1)
    points = rng.normal(size=(9000, 3)).astype(np.float32)
    broken = rng.random(9000) < 0.1
    points[broken, rng.integers(0, 3, broken.sum())] = rng.choice([np.nan, np.inf, -np.inf], broken.sum())
    index = sdm.MeshIndex(sdm.TriangleMesh(VERTICES, FACES), "cpu")
    values = index.signed_distance(points)
    assert torch.equal(values.isnan(), torch.from_numpy(broken))
    torch.testing.assert_close(values[~broken], index.signed_distance(points[~broken]), rtol=0, atol=1e-6)


def test_vertices_that_no_face_uses():
    """They neither count nor stretch anything."""
    more = np.concatenate([VERTICES, [[1e20, -1e20, 0], [5, 5, 5]]]).astype(np.float32)
    expected = sdm.signed_distance(sdm.TriangleMesh(VERTICES, FACES), POINTS, device="cpu")
    assert torch.equal(sdm.signed_distance(sdm.TriangleMesh(more, FACES), POINTS, device="cpu"), expected)


@pytest.mark.parametrize("size", [1e-44, 1e-40, 3e-38, 1e-30, 1e29])
def test_sizes_at_the_ends_of_float32(size):
    mesh = sdm.TriangleMesh(np.array([[-1, -1, -1], [3, -1, -1], [-1, 3, -1]]) * size, [[0, 1, 2]])
    values = sdm.signed_distance(mesh, np.array([[0, 0, 0], [0, 0, 1]]) * size, device="cpu")
    one = float(np.float32(size))
    np.testing.assert_allclose(values.double(), [one, 2 * one], rtol=1e-6, atol=3e-45)


def test_points_beyond_any_mesh():
    """As far as float32 goes, nothing turns into NaN."""
    far = np.array([[3e38, 0, 0], [-3e38, 1e38, 2e38], [1e25, 1e25, -1e25]])
    for scale in (1e-20, 1.0, 1e20):
        index = sdm.MeshIndex(sdm.TriangleMesh(VERTICES * np.float32(scale), FACES), "cpu")
        values = index.signed_distance(far)
        expected = np.linalg.norm(far, axis=1)
        np.testing.assert_allclose(values.double(), np.where(expected > 3.4e38, np.inf, expected), rtol=1e-5)
        assert (index.winding_number(far) == 0).all()
