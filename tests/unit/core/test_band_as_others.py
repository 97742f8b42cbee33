"""Bands as grids of fVDB: the real library where it is installed, and one that does as its documentation says."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.meshes import sphere
from sdm.errors import SDMError


class Jagged:
    """A list of tensors in one."""

    def __init__(self, tensors: list[torch.Tensor]) -> None:
        self.jdata = torch.cat(tensors)


class Grids:
    """Voxels in an order of their own."""

    def __init__(self, ijk: Jagged, voxel_sizes: list[float], origins: list[float]) -> None:
        mixed = torch.randperm(len(ijk.jdata), generator=torch.Generator("cpu").manual_seed(1), device="cpu")
        self.ijk, self.voxel_sizes, self.origins = Jagged([ijk.jdata[mixed]]), voxel_sizes, origins

    def ijk_to_index(self, ijk: Jagged) -> Jagged:
        places = {tuple(voxel): place for place, voxel in enumerate(self.ijk.jdata.tolist())}
        return Jagged([torch.tensor([places[tuple(voxel)] for voxel in ijk.jdata.tolist()], device="cpu")])


class GridsSince03(Grids):
    from_ijk: Any = None


GridsSince03.from_ijk = GridsSince03


def band(turned: bool = False) -> sdm.SparseSDM:
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) if turned else np.eye(3)
    grid = sdm.Grid((-1.2, -1.1, -1.3), (0.1, 0.12, 0.1), (21, 20, 22), turn)
    return sdm.narrow_band(sdm.TriangleMesh(*sphere(6)), grid, half_width=1.5, device="cpu")


def assert_has_the_band(grid: Any, values: Any, made: sdm.SparseSDM) -> None:
    assert len(values.jdata) == made.active_voxels
    torch.testing.assert_close(values.jdata, made.at(grid.ijk.jdata), rtol=0, atol=0)


@pytest.mark.parametrize("since", ["0.3", "before"])
def test_values_follow_the_order_of_the_grid(since, monkeypatch):
    now = since == "0.3"
    library = SimpleNamespace(
        JaggedTensor=Jagged, GridBatch=GridsSince03 if now else SimpleNamespace(), gridbatch_from_ijk=Grids
    )
    monkeypatch.setitem(sys.modules, "fvdb", library)
    made = band()
    grid, values = made.to_fvdb()
    assert isinstance(grid, GridsSince03) == now
    assert_has_the_band(grid, values, made)
    assert (grid.voxel_sizes, grid.origins) == (list(made.grid.spacing), list(made.grid.origin))
    asking = made.values.clone().requires_grad_()
    made.with_values(asking).to_fvdb()[1].jdata.sum().backward()
    assert torch.equal(asking.grad != 0, made.values.abs() < made.width)
    with pytest.raises(SDMError, match="a turned grid"):
        band(turned=True).to_fvdb()


def test_the_real_library():
    pytest.importorskip("fvdb")
    made = band()
    assert_has_the_band(*made.to_fvdb(), made)


def test_without_the_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "fvdb", None)
    with pytest.raises(SDMError, match="pip install fvdb-core"):
        band().to_fvdb()
