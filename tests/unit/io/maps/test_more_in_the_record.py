"""The record of a map beside its geometry: the length at which distances are cut, and the normalisation of its mesh."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sdm.core.grid import Grid
from sdm.core.normalization import Normalization
from sdm.core.signed_distance_map import SDM
from sdm.errors import FormatError, MeshError
from sdm.io import FORMATS, load, save

GRID = Grid((0, 0.1, -3), (0.25, 0.25, 0.25), (9, 8, 10))
BY = Normalization("sphere", (0.1, -2.0, 1 / 3), 1.7)


@pytest.mark.parametrize("ending", FORMATS)
def test_it_comes_back(ending, tmp_path):
    values = torch.linspace(-0.5, 0.5, GRID.size).reshape(GRID.shape)
    for more in ({"truncated": 0.5}, {"truncated": 0.5, "normalization": BY}, {}):
        field = SDM(values, GRID, 0, sign="winding", **more)
        if ending == "nvdb" and "normalization" in more:
            with pytest.raises(FormatError, match="no room"):
                save(field, tmp_path / f"map.{ending}")
            continue
        save(field, tmp_path / f"map.{ending}")
        again = load(tmp_path / f"map.{ending}")
        assert again.truncated == more.get("truncated")
        assert again.normalization == more.get("normalization")
        np.testing.assert_array_equal(again.numpy(), values.numpy())


@pytest.mark.parametrize("ending", ["npz", "zarr"])
def test_half_precision_takes_half_the_room(ending, tmp_path):
    grid = Grid((0, 0, 0), (1.0, 1.0, 1.0), (40, 40, 40))
    values = torch.from_numpy(np.random.default_rng(0).normal(size=grid.shape).astype(np.float16))
    path = tmp_path / f"map.{ending}"
    save(SDM(values, grid), path)
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) or path.stat().st_size
    assert size < 0.55 * grid.nbytes
    again = load(path)
    assert again.values.dtype == torch.float32
    np.testing.assert_array_equal(again.numpy(), values.float().numpy())


def test_a_map_that_was_kept_by_torch(tmp_path):
    field = SDM(torch.zeros(GRID.shape), GRID, truncated=1.0, normalization=BY)
    torch.save(field, tmp_path / "map.pt")
    assert torch.load(tmp_path / "map.pt").normalization == BY


@pytest.mark.parametrize("kind", ["sphere", "cube"])
def test_normalisation_and_back(kind):
    from sdm.core.demo_mesh import demo_mesh

    mesh = demo_mesh(rings=21, segments=12, cap_rings=2)
    by = Normalization.of(mesh, kind)
    unit = by.normalised(mesh)
    low, high = unit.bounds
    np.testing.assert_allclose(low + high, 0, atol=1e-6)
    size = np.linalg.norm(unit.vertices.numpy(), axis=1).max() * 1.03 if kind == "sphere" else (high - low).max() / 2
    assert abs(size - 1) < 1e-6
    np.testing.assert_allclose(by.restored(unit).vertices, mesh.vertices, rtol=1e-5, atol=1e-5)
    assert Normalization.parse(str(by)) == by


def test_a_mesh_without_size_cannot_be_normalised():
    from sdm.core.mesh import TriangleMesh

    point = TriangleMesh([[1.0, 2, 3]], [[0, 0, 0]])
    for kind in ("sphere", "cube"):
        with pytest.raises(MeshError, match="cannot be normalised"):
            Normalization.of(point, kind)
