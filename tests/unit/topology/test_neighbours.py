"""Neighbours and owners against plain loops over all faces."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings

from sdm.bench.common.meshes import sphere
from sdm.topology.face_pairing import neighbours
from tests.helpers import strategies


def _check(vertices: np.ndarray, faces: np.ndarray) -> None:
    found = neighbours(torch.tensor(faces), len(vertices)).tolist()
    at_edge: dict[frozenset, list[int]] = {}
    at_corner: dict[int, int] = {}
    for f, face in enumerate(faces.tolist()):
        for k in range(3):
            at_corner.setdefault(face[k], f)
            if face[k] != face[(k + 1) % 3]:
                at_edge.setdefault(frozenset((face[k], face[(k + 1) % 3])), []).append(3 * f + k)
    for f, face in enumerate(faces.tolist()):
        for k in range(3):
            owns_corner, owns_edge = bool(found[f][3] & (1 << k)), bool(found[f][3] & (8 << k))
            assert owns_corner == (at_corner[face[k]] == f)
            if face[k] == face[(k + 1) % 3]:
                assert found[f][k] == -1
                assert not owns_edge
                continue
            sharers = at_edge[frozenset((face[k], face[(k + 1) % 3]))]
            assert owns_edge == (sharers[0] == 3 * f + k)
            others = [h for h in sharers if h != 3 * f + k]
            assert found[f][k] in others if others else found[f][k] == -1


@settings(max_examples=50)
@given(strategies.soups())
def test_of_any_faces(mesh):
    _check(mesh.vertices, mesh.faces)


def test_of_a_closed_mesh_every_part_has_one_owner():
    vertices, faces = sphere(8)
    _check(vertices, faces)
    bits = neighbours(torch.tensor(faces), len(vertices))[:, 3]
    owned = sum(int(((bits >> b) & 1).sum()) for b in range(6))
    assert owned == len(faces) * 3 // 2 + len(vertices)
