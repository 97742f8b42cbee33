"""The fast path of maps against the plain one, voxel by voxel, on every mesh of the data folder."""

from __future__ import annotations

import pytest
import torch

import sdm
from sdm.bench.common.meshes import load_case, missing_note, names
from sdm.engine.plan_override import plan_override
from tests.helpers.exactness import ROUNDING, scale_of

REAL = names(["real"])
# Coarse, so that lists are long and cells are cut by the border; and as fine as the CPU has time for.
RESOLUTIONS = [pytest.param(13, id="13"), pytest.param(48, id="48", marks=pytest.mark.slow)]


def maps_of(name, resolution, device):
    if (note := missing_note(name)) is not None:
        pytest.skip(note)
    case = load_case(name)
    mesh = sdm.TriangleMesh(case.vertices, case.faces, name)
    grid = sdm.Grid.around(mesh, resolution=resolution)
    index = sdm.MeshIndex(mesh, device)
    found = []
    for method in ("cells", "search"):
        with plan_override(method=method):
            found.append(index.signed_distance_map(grid))
    scale = scale_of(case.vertices, case.faces, grid.points().reshape(-1, 3).numpy())
    return found, torch.from_numpy(ROUNDING * scale).reshape(grid.shape)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@pytest.mark.parametrize("name", REAL)
def test_same_values(name, resolution, device):
    (fast, plain), rounding = maps_of(name, resolution, device)
    a, b = fast.values.cpu().double(), plain.values.cpu().double()
    # Each may be four roundings off.
    apart = (a.abs() - b.abs()).abs() / rounding
    assert apart.max() <= 8, f"{float(apart.max()):.1f} roundings apart at {apart.argmax()}"
    clear = b.abs() > 4 * rounding
    assert torch.equal((a < 0) & clear, (b < 0) & clear)
    assert fast.ambiguous_voxels == plain.ambiguous_voxels


@pytest.mark.gpu
@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_same_values_on_a_fine_grid(name):
    (fast, plain), rounding = maps_of(name, 128, "cuda")
    apart = (fast.values.cpu().double().abs() - plain.values.cpu().double().abs()).abs() / rounding
    assert apart.max() <= 8
    assert fast.ambiguous_voxels == plain.ambiguous_voxels
