from __future__ import annotations

import time

import numpy as np
import pytest
import torch

from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.engine.mesh_index import MeshIndex
from sdm.io import FORMATS, grid_like, load, save, write_streamed
from sdm.io.maps.record import digest_of
from sdm.io.maps.save_and_load import made_from

ENDINGS = list(FORMATS)
TURN = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
GRIDS = {
    "plain": Grid((0, 0, 0), (1, 1, 1), (5, 4, 3)),
    "unequal": Grid((1 / 3, -2e-7, 123456.789), (0.1, 0.2, 1 / 3), (9, 17, 8)),
    "turned": Grid((-50.3, 20.1, 3), (0.7, 0.8, 1.9), (6, 7, 10), TURN),
    "mirrored": Grid((1, 2, 3), (0.5, 0.5, 0.5), (4, 4, 4), np.diag([-1.0, -1.0, 1.0])[[1, 0, 2]]),
    "far": Grid((1e7 + 0.1, 0, 0), (1e-3, 1e-3, 1e-3), (3, 3, 3)),
    "tiny": Grid((1e-9, 0, 0), (1e-12, 3e-12, 1e-12), (3, 3, 3)),
    "one voxel": Grid((0.1, 0.2, 0.3), (0.4, 0.5, 0.6), (1, 1, 1)),
    "flat": Grid((0, 0, 0), (1, 1, 1), (1, 130, 2)),
}


def noise(grid: Grid, count: int | None = 3) -> SDM:
    values = np.random.default_rng(0).normal(size=grid.shape).astype(np.float32)
    return SDM(torch.from_numpy(values), grid, count)


def bits(field: SDM) -> np.ndarray:
    assert field.values.dtype == torch.float32
    assert field.values.is_contiguous()
    return field.numpy().view(np.uint32)


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
@pytest.mark.parametrize("ending", ENDINGS)
def test_values_and_geometry_come_back_to_the_last_bit(ending, grid, tmp_path):
    field = noise(grid)
    field.save(tmp_path / f"map.{ending}")
    again = load(tmp_path / f"map.{ending}")
    np.testing.assert_array_equal(bits(again), bits(field))
    assert again.grid == grid
    assert again.ambiguous_voxels == 3
    assert grid_like(tmp_path / f"map.{ending}") == grid
    # Nothing but the map is left in the folder.
    assert [path.name for path in tmp_path.iterdir()] == [f"map.{ending}"]


@pytest.mark.parametrize("count", [None, 0, 2**40])
@pytest.mark.parametrize("ending", ENDINGS)
def test_the_number_of_ambiguous_voxels_is_kept(ending, count, tmp_path):
    save(noise(GRIDS["plain"], count), tmp_path / f"map.{ending}")
    assert load(tmp_path / f"map.{ending}").ambiguous_voxels == count


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_mesh_of_a_map_is_kept(ending, tmp_path):
    ball = TriangleMesh(np.eye(4, 3, dtype=np.float32), [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    index, path = MeshIndex(ball, "cpu"), tmp_path / f"map.{ending}"
    write_streamed(index, GRIDS["turned"], path)
    assert made_from(path) is None
    plain = load(path)
    write_streamed(index, GRIDS["turned"], path, made_from=digest_of(ball))
    assert made_from(path) == digest_of(ball)
    again = load(path)
    np.testing.assert_array_equal(bits(again), bits(plain))
    assert (again.grid, again.ambiguous_voxels) == (plain.grid, plain.ambiguous_voxels)
    others = ball.flipped(), TriangleMesh(ball.vertices + 1, ball.faces), TriangleMesh(ball.vertices, ball.faces[:3])
    assert len({digest_of(mesh) for mesh in (ball, *others)}) == 4


@pytest.mark.parametrize("ending", ENDINGS)
def test_values_of_every_kind(ending, tmp_path):
    grid = Grid((0, 0, 0), (1, 1, 1), (2, 2, 2))
    special = np.array([-0.0, 0.0, np.nan, np.inf, -np.inf, 1e-45, -3.4e38, 1.0], np.float32)
    field = SDM(torch.from_numpy(special.reshape(2, 2, 2)), grid)
    save(field, tmp_path / f"map.{ending}")
    np.testing.assert_array_equal(bits(load(tmp_path / f"map.{ending}")), bits(field))


@pytest.mark.parametrize("ending", ENDINGS)
def test_zeros_alone(ending, tmp_path):
    grid = Grid((0, 0, 0), (1, 1, 1), (2, 3, 4))
    field = SDM(-torch.zeros(grid.shape), grid)
    save(field, tmp_path / f"map.{ending}")
    np.testing.assert_array_equal(bits(load(tmp_path / f"map.{ending}")), bits(field))


@pytest.mark.parametrize("ending", ENDINGS)
def test_doubles_and_strided_values_become_plain_floats(ending, tmp_path):
    grid = Grid((0, 0, 0), (1, 1, 1), (4, 3, 2))
    values = torch.arange(24, dtype=torch.float64).reshape(2, 3, 4).permute(2, 1, 0).requires_grad_()
    save(SDM(values, grid), tmp_path / f"map.{ending}")
    np.testing.assert_array_equal(load(tmp_path / f"map.{ending}").numpy(), values.detach().numpy())


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_new_map_takes_the_place_of_an_old_one(ending, tmp_path):
    path = tmp_path / f"map.{ending}"
    save(noise(GRIDS["plain"]), path)
    save(noise(GRIDS["turned"], None), path)
    assert load(path).grid == GRIDS["turned"]
    assert list(tmp_path.iterdir()) == [path]


def test_the_same_map_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        save(noise(GRIDS["turned"]), tmp_path / f"{name}.nii.gz")
    assert (tmp_path / "a.nii.gz").read_bytes() == (tmp_path / "b.nii.gz").read_bytes()


def test_endings_in_capitals_and_names_with_dots(tmp_path):
    for name in ("MAP.NPZ", "a.b.c.nii.gz", "weird name.Nii"):
        save(noise(GRIDS["plain"]), tmp_path / name)
        assert load(str(tmp_path / name)).grid == GRIDS["plain"]


def test_a_relative_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for ending in ENDINGS:
        save(noise(GRIDS["plain"]), f"map.{ending}")
        assert load(f"map.{ending}").grid == GRIDS["plain"]


@pytest.mark.parametrize("ending", ENDINGS)
def test_files_say_by_which_method_a_map_is_signed(tmp_path, ending):
    grid, path = GRIDS["unequal"], tmp_path / f"map.{ending}"
    values = noise(grid).values
    for said in (
        {"sign": "winding", "hole_size": None, "sign_disagreements": None},
        {"sign": "flood", "hole_size": 1 / 3, "sign_disagreements": 17},
        {"sign": "none", "hole_size": None, "sign_disagreements": 0},
        {"sign": None, "hole_size": None, "sign_disagreements": None},
    ):
        save(SDM(values, grid, **said), path)
        back = load(path)
        assert {name: getattr(back, name) for name in said} == said


@pytest.mark.parametrize("ending", ENDINGS)
def test_streamed_files_have_the_wanted_sign(tmp_path, ending):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    index = MeshIndex(TriangleMesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]), "cpu")
    grid, path = Grid.around(index.mesh, 12), tmp_path / f"map.{ending}"
    for sign, hole in (("winding", None), ("flood", 0.25), ("none", None)):
        counts = write_streamed(index, grid, path, sign=sign, hole_size=hole)
        back = load(path)
        assert torch.equal(back.values, index.signed_distance_map(grid, sign=sign, hole_size=hole).values)
        assert (back.sign, back.hole_size, counts.inside) == (sign, hole, back.inside_voxels)


def test_files_do_not_tell_the_time(tmp_path):
    """Of formats whose writers would note it: a map that is made again is the same file."""
    contents = []
    for number in range(2):
        # The times of these formats are whole seconds.
        time.sleep(1.1 * number)
        files = [tmp_path / f"map.{ending}" for ending in ENDINGS if ending != "zarr"]
        for file in files:
            save(noise(GRIDS["plain"]), file)
        contents.append({file.name: file.read_bytes() for file in files})
    assert contents[0] == contents[1]
    assert b"generated by pynrrd\n# Complete" in contents[0]["map.nrrd"]
