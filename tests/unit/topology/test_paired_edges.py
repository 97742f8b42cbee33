"""Edges that are paired: what is said of closed meshes is what boundary edges say."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.paired_edges import every_edge_is_paired


def faces_of(mesh: trimesh.Trimesh) -> np.ndarray:
    return np.asarray(mesh.faces, np.int32)


BALL = faces_of(trimesh.creation.icosphere(2))


@pytest.mark.parametrize(
    "faces",
    [
        BALL,
        BALL[:, ::-1],
        np.concatenate([BALL, BALL + 1000]),
        faces_of(trimesh.creation.torus(2, 1)),
        np.array([[0, 1, 2], [0, 2, 1]], np.int32),
    ],
    ids=["ball", "inside out", "two balls", "torus", "two faces"],
)
def test_closed_meshes(faces):
    assert every_edge_is_paired(faces)


@pytest.mark.parametrize(
    "faces",
    [
        BALL[:-1],
        BALL[:-2],
        np.concatenate([BALL[:-1], BALL[-1:, ::-1]]),
        # Each edge of four faces.
        np.concatenate([BALL, BALL]),
        np.concatenate([BALL, [[0, 0, 0]]]).astype(np.int32),
        np.concatenate([BALL, [[0, 0, 1], [1, 0, 0]]]).astype(np.int32),
        BALL[:1],
    ],
    ids=["odd", "open", "one turned", "twice", "a point", "a needle", "one face"],
)
def test_others(faces):
    assert not every_edge_is_paired(faces)


def test_of_what_is_paired_no_edge_is_a_boundary():
    rng, said = np.random.default_rng(0), 0
    vertices = torch.from_numpy(rng.standard_normal((5, 3)).astype(np.float32))
    for _ in range(3000):
        # Of few vertices, so that some are closed.
        faces = np.array([rng.permutation(4)[:3] for _ in range(rng.choice([2, 4]))], np.int32)
        if every_edge_is_paired(faces):
            said += 1
            assert boundary_edges(vertices, torch.from_numpy(np.ascontiguousarray(faces))).shape[0] == 0
    assert said > 10


def test_numbers_beyond_16_bits():
    assert every_edge_is_paired(BALL + 2**30)
