from __future__ import annotations

import numpy as np
import pytest
import torch

from sdm.core.mesh import TriangleMesh
from sdm.errors import MeshError, SDMError

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], dtype=np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)


def test_keeps_float32_and_int32_without_a_copy():
    vertices, faces = torch.from_numpy(VERTICES.copy()), torch.from_numpy(FACES.copy())
    mesh = TriangleMesh(vertices, faces)
    assert mesh.vertices.data_ptr() == vertices.data_ptr()
    assert mesh.faces.data_ptr() == faces.data_ptr()
    assert len(mesh) == 4


def test_numpy_arrays_are_shared_too():
    vertices = VERTICES.copy()
    assert TriangleMesh(vertices, FACES.copy()).numpy()[0].ctypes.data == vertices.ctypes.data


@pytest.mark.parametrize("dtype", [np.float16, np.float64, np.longdouble, ">f4", np.int16, np.uint8])
def test_any_real_vertices_become_float32(dtype):
    mesh = TriangleMesh(VERTICES.astype(dtype), FACES)
    assert mesh.vertices.dtype == torch.float32
    np.testing.assert_array_equal(mesh.numpy()[0], VERTICES)


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint16, np.uint32, np.int64, np.uint64, ">i4"])
def test_any_integer_faces_become_int32(dtype):
    mesh = TriangleMesh(VERTICES, FACES.astype(dtype))
    assert mesh.faces.dtype == torch.int32
    np.testing.assert_array_equal(mesh.numpy()[1], FACES)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.uint32, torch.uint64, torch.int64])
def test_any_integer_tensor_of_faces_becomes_int32(dtype):
    mesh = TriangleMesh(VERTICES, torch.from_numpy(FACES).to(dtype))
    np.testing.assert_array_equal(mesh.numpy()[1], FACES)


def test_views_lists_and_read_only_arrays_work():
    backward, frozen = VERTICES[:, ::-1], FACES.copy()
    frozen.flags.writeable = False
    np.testing.assert_array_equal(TriangleMesh(backward, frozen).numpy()[0], backward)
    np.testing.assert_array_equal(TriangleMesh(VERTICES.tolist(), FACES.tolist()).numpy()[1], FACES)


def test_dlpack_is_shared():
    class Foreign:
        def __init__(self, tensor):
            self.tensor = tensor

        def __dlpack__(self, **keywords):
            return self.tensor.__dlpack__(**keywords)

        def __dlpack_device__(self):
            return self.tensor.__dlpack_device__()

    vertices = torch.from_numpy(VERTICES.copy())
    assert TriangleMesh(Foreign(vertices), FACES).vertices.data_ptr() == vertices.data_ptr()


def test_gradients_flow_through():
    vertices = torch.from_numpy(VERTICES.astype(np.float64)).requires_grad_()
    TriangleMesh(vertices, FACES).vertices.sum().backward()
    assert vertices.grad is not None
    assert bool((vertices.grad == 1).all())


def test_bounds_cover_used_vertices_only():
    far = np.concatenate([VERTICES, [[9e9, 9e9, 9e9]]]).astype(np.float32)
    low, high = TriangleMesh(far, FACES).bounds
    np.testing.assert_array_equal(low, [0, 0, 0])
    np.testing.assert_array_equal(high, [1, 2, 3])


def test_flipped_reverses_each_face():
    flipped = TriangleMesh(VERTICES, FACES, "tetrahedron").flipped()
    np.testing.assert_array_equal(flipped.numpy()[1], FACES[:, ::-1])
    assert flipped.name == "tetrahedron"


def nan_at(row: int) -> np.ndarray:
    vertices = VERTICES.copy()
    vertices[row, 1] = np.nan
    return vertices


@pytest.mark.parametrize(
    ("vertices", "faces", "says"),
    [
        (VERTICES, [], "ball has no triangles"),
        (VERTICES, np.zeros((0, 3), int), "ball has no triangles"),
        (VERTICES, np.zeros((0, 4), int), "ball has no triangles"),
        (np.zeros((0, 3)), FACES, "ball has no triangles"),
        (VERTICES[:, :2], FACES, r"shape \(4, 2\)"),
        (VERTICES[0], FACES, r"shape \(3,\)"),
        (VERTICES, np.array([[0, 1, 2, 3]]), "triangulate"),
        (VERTICES, FACES + 1, "uses vertex 4, but its 4 vertices are numbered 0 to 3; .*counted from 1.*: subtract 1"),
        (VERTICES.T, FACES, r"shape \(3, 4\); \(V, 3\) is needed: transpose it"),
        (VERTICES, FACES.T, r"shape \(3, 4\); \(F, 3\) is needed: transpose it"),
        (VERTICES, FACES - 1, "uses vertex -1"),
        (VERTICES, FACES.astype(np.int64) + 2**32, "index 4294967299, which is out of range"),
        (VERTICES, FACES.astype(np.uint32) + np.uint32(2**31), "out of range"),
        (VERTICES, torch.full((1, 3), 2**32 - 1, dtype=torch.uint32), "index 4294967295, which is out of range"),
        (VERTICES, FACES.astype(float), "give integers"),
        (VERTICES, FACES.astype(bool), "numbers"),
        (VERTICES, torch.from_numpy(FACES).bool(), "numbers"),
        (VERTICES.astype(complex), FACES, "numbers"),
        (torch.from_numpy(VERTICES).to(torch.complex64), FACES, "numbers"),
        (np.array([["a", "b", "c"]] * 4), FACES, "numbers"),
        ([[0, 0, 0], [1, 0]], FACES, "different lengths"),
        (nan_at(2), FACES, "vertex 2 of ball"),
        (np.full((4, 3), np.inf), FACES, "finite"),
        (VERTICES.astype(np.float64) * 1e39, FACES, "finite"),
        (VERTICES * np.float32(1e31), FACES, "larger unit"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(vertices, faces, says):
    with pytest.raises(MeshError, match=says) as caught:
        TriangleMesh(vertices, faces, "ball")
    assert isinstance(caught.value, SDMError)
    assert "\n" not in str(caught.value)


def test_check_can_be_left_out():
    assert len(TriangleMesh(nan_at(1), FACES, check=False)) == 4
