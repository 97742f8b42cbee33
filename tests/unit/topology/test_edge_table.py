"""Pairing of faces by a hash table: what a sort finds, whatever the faces and their order."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sdm.bench.common.dirty_meshes.by_code import loose, torn, turned
from sdm.bench.common.mesh_formulas import torus
from sdm.kernels.topology.edge_table import MOST_ALIKE
from sdm.topology.face_pairing import queue_pairing


def _crowded(mesh, rng):
    """Faces twice and thrice, some the other way round, some with a vertex twice, and a fan about one edge."""
    vertices, faces = mesh
    again = faces[rng.integers(0, len(faces), 40)]
    flat = faces[rng.integers(0, len(faces), 12)].copy()
    flat[:, 1] = flat[:, 0]
    fan = faces[:1].repeat(1000, 0).copy()
    fan[:, 2] = rng.integers(0, len(vertices), len(fan))
    return vertices, np.concatenate([faces, again, again[:9, [1, 0, 2]], flat, fan])


KINDS = {
    "closed": lambda mesh, rng: mesh,
    "torn": lambda mesh, rng: torn(mesh, 0.3),
    "turned": lambda mesh, rng: turned(mesh, 0.5),
    "loose": lambda mesh, rng: loose(mesh),
    "crowded": _crowded,
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [60, 900, 5000])
def test_the_same_as_by_a_sort(kind, size):
    rng = np.random.default_rng(size)
    vertices, faces = KINDS[kind](torus(size), rng)
    given = torch.from_numpy(np.ascontiguousarray(rng.permutation(faces), dtype=np.int32))
    (flags, unmatched, around), (wanted, theirs, expected) = (
        queue_pairing(given, len(vertices), by_table=by_table) for by_table in (True, False)
    )
    assert flags.tolist() == wanted.tolist()
    assert torch.equal(around, expected)
    rows = int(flags[1])
    assert (rows == 0) == (kind == "closed")
    assert sorted(unmatched[:rows].tolist()) == sorted(theirs[:rows].tolist())


def test_many_faces_at_one_edge_are_told():
    _, faces = torus(200)
    given = torch.from_numpy(np.concatenate([faces, faces[:1].repeat(MOST_ALIKE - 1, 0)]))
    assert queue_pairing(given, 1000, by_table=True)[0][0] == 1
    assert queue_pairing(given[:-1].contiguous(), 1000, by_table=True)[0][0] == 0
