"""Bands of meshes never seen before, as a GPU makes them: queued while the topology is found, with the same bits."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere, torus
from sdm.engine.band import calls, repeated_bands

MESHES = {
    "closed": lambda v, f: (v, f),
    "a wide opening": lambda v, f: (v, f[5:]),
    "three holes": lambda v, f: (v, np.delete(f, [3, 50, 90], 0)),
    "no shared vertices": lambda v, f: (v[f].reshape(-1, 3), np.arange(f.size, dtype=np.int32).reshape(-1, 3)),
    "faces twice": lambda v, f: (v, np.concatenate([f, f[:10]])),
}


@pytest.mark.filterwarnings("ignore::sdm.SDMWarning")
@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("shape", [sphere(9), torus(900)], ids=["sphere", "torus"])
def test_the_bits_of_an_index(kind, shape, monkeypatch):
    vertices, faces = MESHES[kind](*shape)

    def fresh() -> sdm.TriangleMesh:
        return sdm.TriangleMesh(vertices.copy(), faces.copy(), check=False)

    noted: list[int] = []
    whole = sdm.Grid.around(fresh(), 60)
    # Whole, and one that the mesh reaches beyond.
    for grid in (whole, sdm.Grid(whole.origin, whole.spacing, (30, *whole.shape[1:]))):
        wanted = sdm.narrow_band(fresh(), grid, device="cpu")
        with monkeypatch.context() as patch:
            patch.setattr(repeated_bands, "is_recordable", lambda mesh: True)
            patch.setattr(repeated_bands, "replayed", lambda *given: None)
            patch.setattr(repeated_bands, "note", lambda *given: noted.append(1))
            patch.setattr(calls, "band_of", None)
            found = sdm.narrow_band(fresh(), grid, device="cpu")
        for name in ("blocks", "values", "inside"):
            assert torch.equal(getattr(found, name), getattr(wanted, name))
        assert found.ambiguous_voxels == wanted.ambiguous_voxels
    assert len(noted) == 2
