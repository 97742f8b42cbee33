"""Sums over components of faces, against plain ones over the components that SciPy finds."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sdm.bench.common.mesh_formulas import cube, inverted, joined, moved, sphere, torus
from sdm.inspect.edges import label
from sdm.topology.component_volumes import every_component_encloses
from sdm.topology.face_pairing import neighbours
from tests.helpers import strategies


def volumes_of(vertices: np.ndarray, faces: np.ndarray, around: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed volume of each component about the middle of its corners, and its area to the power of 3/2."""
    face, k = np.nonzero(around[:, :3] >= 0)
    component = label(face, around[face, k] // 3, len(faces))
    volumes, areas = [], []
    for number in np.unique(component):
        corner = vertices.astype(np.float64)[faces[component == number]]
        a, b, c = np.moveaxis(corner - corner.mean((0, 1)), 1, 0)
        normal = np.cross(b - a, c - a)
        volumes.append((a * normal).sum() / 6)
        areas.append(np.linalg.norm(normal, axis=1).sum() / 2)
    return np.array(volumes), np.array(areas) ** 1.5


def check(vertices: np.ndarray, faces: np.ndarray, device: str = "cpu") -> None:
    where, index = torch.tensor(vertices, device=device), torch.tensor(faces, device=device)
    around = neighbours(index, len(vertices))
    volumes, areas = volumes_of(vertices, faces, around.cpu().numpy())
    shares = volumes / np.where(areas > 0, areas, 1)
    for least in (shares.min() - 1e-6, shares.min() + 1e-6):
        expected = bool((volumes > least * areas).all())
        assert every_component_encloses(float(least), where, index, around) == expected
    # A component without area is never enough.
    assert expected is False


@settings(max_examples=30)
@given(st.one_of(strategies.soups(30), strategies.closed(), strategies.shells(8)))
def test_of_any_mesh(mesh):
    check(mesh.vertices, mesh.faces)


@pytest.mark.parametrize("threads", [1, 4])
def test_long_components_in_any_order(device, threads, monkeypatch):
    """A torus, a far ball and a small one inside out, whose faces come in any order: threads meet everywhere."""
    monkeypatch.setenv("SDM_NUM_THREADS", str(threads))
    vertices, faces = joined(torus(12_000), moved(sphere(12), 1.0, (100.0, 0, 0)), moved(inverted(cube()), 1e-3))
    for seed in range(3):
        check(vertices, faces[np.random.default_rng(seed).permutation(len(faces))], device)
    check(vertices, faces, device)


def test_three_faces_at_an_edge_are_of_one_component():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 1], [0, 1, 1]], np.float32)
    check(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], np.int32))


def test_what_is_not_a_number_encloses_nothing():
    vertices, faces = sphere(4)
    vertices = vertices.copy()
    vertices[faces[3, 0]] = np.nan
    where, index = torch.tensor(vertices), torch.tensor(faces)
    assert not every_component_encloses(-1.0, where, index, neighbours(index, len(vertices)))
