# Kernels are typed by Warp's rules.
# pyright: reportInvalidTypeForm=false, reportOperatorIssue=false
from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
import torch
import trimesh
import warp as wp

from sdm.core.grid import Grid
from sdm.core.signed_distance_map import SDM
from sdm.engine.api import signed_distance_map
from sdm.errors import FormatError
from sdm.io import grid_like, load, save

TURN = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
GRID = Grid((-50.3, 20.1, 3), (0.7, 0.8, 1.9), (17, 7, 10), TURN)


@wp.kernel(enable_backward=False)
def to_world(volume: wp.uint64, index: wp.array(dtype=wp.vec3), world: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    world[i] = wp.volume_index_to_world(volume, index[i])


@pytest.fixture
def saved(tmp_path):
    values = torch.from_numpy(np.random.default_rng(0).normal(size=GRID.shape).astype(np.float32))
    field = SDM(values, GRID, None)
    save(field, tmp_path / "map.nvdb")
    return field, tmp_path / "map.nvdb"


def test_warp_sees_the_grid_where_it_is(saved):
    _, path = saved
    volume = wp.Volume.load_from_nvdb(path.read_bytes(), device="cpu")
    index = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [3, 4, 5]], np.float32)
    world = wp.zeros(4, dtype=wp.vec3, device="cpu")
    wp.launch(to_world, 4, [volume.id, wp.array(index, dtype=wp.vec3, device="cpu"), world], device="cpu")
    expected = index @ GRID.affine[:3, :3].T + GRID.affine[:3, 3]
    np.testing.assert_allclose(world.numpy(), expected, rtol=1e-5)


def test_the_header_has_the_transform_in_double_precision(saved):
    _, path = saved
    data = path.read_bytes()
    # GridData comes after the file's header, its metadata, the name and the size of what is compressed.
    begin = 16 + 176 + struct.unpack_from("<I", data, 16 + 136)[0]
    data, at = zlib.decompress(data[begin + 8 :]), 0
    assert data[at : at + 7] == b"NanoVDB"
    doubles = struct.unpack_from("<22d", data, at + 40 + 256 + 88)
    np.testing.assert_array_equal(np.reshape(doubles[:9], (3, 3)), GRID.affine[:3, :3])
    np.testing.assert_allclose(np.reshape(doubles[9:18], (3, 3)) @ GRID.affine[:3, :3], np.eye(3), atol=1e-12)
    assert doubles[18:21] == GRID.origin
    assert struct.unpack_from("<3d", data, at + 608) == GRID.spacing
    assert struct.unpack_from("<2I", data, at + 632) == (1, 1)  # a level set of floats


def test_a_flipped_bit_of_the_name_is_found(saved):
    """The name in the file's head says where the values are, and nothing else there has a checksum."""
    field, path = saved
    whole = path.read_bytes()
    size = struct.unpack_from("<I", whole, 16 + 136)[0]
    for place in range(16 + 176, 16 + 176 + size - 1):
        data = bytearray(whole)
        data[place] ^= 1 << place % 7
        path.write_bytes(data)
        with pytest.raises(FormatError, match=r"is damaged|was not written by sdm"):
            load(path)
        with pytest.raises(FormatError, match=r"is damaged|was not written by sdm"):
            grid_like(path)
    path.write_bytes(whole)
    assert load(path).grid == field.grid


def test_around_the_map_it_is_outside(saved):
    field, path = saved
    volume = wp.Volume.load_from_nvdb(path.read_bytes(), device="cpu")
    outside = wp.zeros(2, dtype=wp.float32, device="cpu")

    wp.launch(look, 2, [volume.id, outside], device="cpu")
    assert outside.numpy().tolist() == [float(field.values.max())] * 2


@wp.kernel(enable_backward=False)
def look(volume: wp.uint64, values: wp.array(dtype=wp.float32)):
    i = wp.tid()
    values[i] = wp.volume_lookup_f(volume, 17 + 50 * i, 0, 0)


def test_a_volume_of_other_software(tmp_path):
    volume = wp.Volume.load_from_numpy(np.zeros((8, 8, 8), np.float32), device="cpu")
    volume.save_to_nvdb(str(tmp_path / "fog.nvdb"))
    with pytest.raises(FormatError, match="not written by sdm"):
        load(tmp_path / "fog.nvdb")


def test_what_warp_cannot_make_is_said(tmp_path, monkeypatch):
    def refuse(*args, **kwargs):
        raise RuntimeError("no volumes on this device")

    monkeypatch.setattr(wp.Volume, "allocate_by_tiles", refuse)
    with pytest.raises(FormatError, match=r"Warp cannot make .* no volumes on this device"):
        save(SDM(torch.zeros(GRID.shape), GRID), tmp_path / "map.nvdb")
    assert list(tmp_path.iterdir()) == []


def of_ball(spacing, **more):
    n = round(2.4 / spacing)
    grid = Grid((-1.2, -1.2, -1.2), (spacing,) * 3, (n, n, n))
    x, y, z = np.meshgrid(*(np.arange(n) * spacing - 1.2 for _ in range(3)), indexing="ij")
    return SDM((np.sqrt(x * x + y * y + z * z) - 1).astype(np.float32), grid, 0, sign="winding", **more)


@pytest.mark.parametrize("shape", [(24, 24, 24), (25, 25, 25), (33, 32, 31), (100, 20, 9), (64, 64, 64)])
@pytest.mark.parametrize("place", [0.0, 0.3])
def test_a_file_is_not_larger_than_its_values(shape, place, tmp_path):
    grid = Grid((-1.2, -1.2, -1.2), tuple(2.4 / n for n in shape), shape)
    balls = [trimesh.creation.icosphere(3), trimesh.creation.icosphere(2, radius=0.4)]
    balls[0].apply_translation([place, -place, place / 2])
    mesh = trimesh.util.concatenate(balls)
    field = signed_distance_map((mesh.vertices, mesh.faces), grid=grid, device="cpu")
    save(field, tmp_path / "map.nvdb")
    assert (tmp_path / "map.nvdb").stat().st_size < grid.nbytes
    np.testing.assert_array_equal(load(tmp_path / "map.nvdb").numpy(), field.numpy())


def test_noise_takes_a_little_more_than_its_values(tmp_path):
    """Values that cannot be compressed have the tree beside them."""
    for n in (2, 8, 16, 40):
        values = np.random.default_rng(n).normal(size=(n, n, n)).astype(np.float32)
        field = SDM(values, Grid((0.0,) * 3, (1.0,) * 3, (n, n, n)), 0, sign="winding")
        save(field, tmp_path / "map.nvdb")
        assert (tmp_path / "map.nvdb").stat().st_size < field.grid.nbytes + 3000


def test_blocks_beyond_the_truncation_are_not_kept(tmp_path):
    whole = of_ball(0.04)
    values = whole.values.clamp(-0.1, 0.1)
    field = SDM(values, whole.grid, 0, sign="winding", truncated=0.1)
    save(field, tmp_path / "map.nvdb")
    volume = wp.Volume.load_from_nvdb((tmp_path / "map.nvdb").read_bytes(), device="cpu")
    blocks = 8**3
    assert volume.get_tiles().shape[0] < blocks
    again = load(tmp_path / "map.nvdb")
    np.testing.assert_array_equal(again.numpy(), field.numpy())
    assert (again.truncated, again.hole_size, again.sign) == (np.float64(0.1), None, "winding")
    assert (tmp_path / "map.nvdb").stat().st_size < field.grid.nbytes / 4
