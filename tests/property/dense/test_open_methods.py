"""Maps of open meshes have the same bits by caps as by the sum over all boundary edges at every voxel."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

import sdm
import sdm.engine.structure.sizes
from sdm.bench.common.meshes import sphere
from sdm.bench.common.oracles.brute_force import Brute
from sdm.kernels.winding import column_sums, open_caps
from sdm.kernels.winding.eights import boxes_by_edges
from sdm.kernels.winding.rims import edge_boxes, every_voxel, exact_voxels
from tests.helpers import strategies

CPU = torch.device("cpu")


def torn(share: float, seed: int) -> strategies.Arrays:
    vertices, faces = sphere(16)
    return strategies.Arrays(vertices, faces[np.random.default_rng(seed).random(len(faces)) >= share])


def half_spheres(count: int, seed: int) -> strategies.Arrays:
    """Open bowls here and there, of all sizes and turned at random; some inside others."""
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(6)
    faces = faces[(vertices[faces][:, :, 2] > -1e-6).all(1)]
    turns = [np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.uniform(0.1, 1) for _ in range(count)]
    places = [vertices @ turn + rng.normal(size=3) for turn in turns]
    index = [faces + len(vertices) * number for number in range(count)]
    return strategies.Arrays(np.concatenate(places).astype(np.float32), np.concatenate(index).astype(np.int32))


def sheets(share: float, seed: int) -> strategies.Arrays:
    """Two walls a thousandth apart that face away from each other; some of their faces are gone, or turned."""
    rng = np.random.default_rng(seed)
    count = 9
    x, y = np.meshgrid(np.linspace(-1, 1, count), np.linspace(-1, 1, count), indexing="ij")
    at = np.arange(count * count).reshape(count, count)
    a, b, c, d = at[:-1, :-1].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel(), at[:-1, 1:].ravel()
    one = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    faces = np.concatenate([one, one[:, ::-1] + count * count])
    faces = faces[rng.random(len(faces)) >= share]
    turned = rng.random(len(faces)) < share
    faces[turned] = faces[turned][:, ::-1]
    z = np.zeros_like(x)
    vertices = np.concatenate([np.stack([x, y, z], -1), np.stack([x, y, z + 1e-3], -1)]).reshape(-1, 3)
    return strategies.Arrays(np.roll(vertices, seed % 3, 1).astype(np.float32), faces.astype(np.int32))


shares, counts = st.sampled_from([0.01, 0.1, 0.3, 0.7]), st.integers(1, 12)
dirt = st.one_of(
    st.builds(torn, shares, strategies.seeds),
    st.builds(half_spheres, counts, strategies.seeds),
    st.builds(sheets, shares, strategies.seeds),
    strategies.soups(30),
    strategies.slivers(20),
    strategies.shells(8),
)


def grid_about(vertices: np.ndarray, shape: tuple[int, int, int], turned: bool, seed: int) -> sdm.Grid:
    """A grid through the middle of a mesh, of unequal steps, or thick, or tiny; in round numbers every other time."""
    rng = np.random.default_rng(seed)
    low, high = vertices.min(0).astype(float), vertices.max(0).astype(float)
    size = float((high - low).max()) or 1.0
    spacing = size * 10.0 ** rng.uniform(-2, -0.7, 3)
    middle = rng.uniform(low, high + 1e-3 * size)
    if seed % 2:
        spacing, middle = 2.0 ** np.round(np.log2(spacing)), np.round(8 * middle) / 8
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turned else np.eye(3)
    turn[:, 2] *= np.linalg.det(turn)
    return sdm.Grid(middle - turn @ (spacing * (np.array(shape) // 2)), spacing, shape, turn)


def both(index: sdm.MeshIndex, grid: sdm.Grid) -> list[sdm.SDM]:
    found = []
    with pytest.MonkeyPatch.context() as patch:
        for method in ("caps", "edges"):
            patch.setattr(column_sums, "OPEN_METHOD", method)
            found.append(index.signed_distance_map(grid))
    return found


@settings(max_examples=40)
@example(torn(0.01, 0), (1, 6, 8), False, 5, 6)  # By edges on a CPU, where a GPU's way has boxes of 2^3.
@example(torn(0.01, 0), (2, 1, 7), False, 5, 94)
@given(
    mesh=dirt, shape=st.tuples(*[st.integers(1, 36)] * 3), turned=st.booleans(),
    last=st.sampled_from([0, 1, 2, 3, 4, 5, 5, -1]), seed=strategies.seeds,
)  # fmt: skip
def test_the_same_bits_and_as_many_ambiguous_voxels(mesh, shape, turned, last, seed):
    """Also where boxes of some size, or all voxels, are left to the sum over all edges, or by edges alone."""
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
    with pytest.MonkeyPatch.context() as patch:
        # Boxes of 4^3 are looked at again, or not; also with little room for nodes and caps.
        patch.setattr(open_caps, "AGAIN", (open_caps.AGAIN, (1e-6,), (1e-4, 1e-5))[seed % 3] if last >= 0 else ())
        patch.setattr(open_caps, "ROOM_AGAIN", (open_caps.ROOM_AGAIN, 6, 60)[seed // 3 % 3])
        patch.setattr(open_caps, "MOST_RECORDS", (open_caps.MOST_RECORDS, 5)[seed // 7 % 2])
        patch.setattr(open_caps, "LEAST_VOXELS", (open_caps.LEAST_VOXELS, 1)[seed // 5 % 2])
        patch.setattr(open_caps, "ROOM_FOR_NEAR", (open_caps.ROOM_FOR_NEAR, (9, 9))[seed // 11 % 2])
        patch.setattr(open_caps, "SUMMED", ((last, np.inf, np.inf),) if last > 0 else ())
        patch.setitem(every_voxel.MOST_SUMS, "cpu", np.inf if last == 4 else 0)
        patch.setitem(edge_boxes.MOST_EDGES, "cpu", np.inf if last == 5 else 0)
        patch.setattr(column_sums, "FACES_AN_EDGE", dict.fromkeys(("cuda", "cpu"), (0, np.inf)))
        patch.setitem(edge_boxes.BOX_BITS, "cpu", 1 + seed % 2)
        patch.setitem(edge_boxes.FEWEST_LARGE, "cpu", (0, np.inf)[seed // 2 % 2])
        patch.setattr(boxes_by_edges, "FEWEST_LARGE", (0, 1, np.inf)[seed // 2 % 3])
        patch.setattr(boxes_by_edges, "FOR_LARGE", (boxes_by_edges.FOR_LARGE, 1.0, 1e-4)[seed // 7 % 3])
        patch.setattr(edge_boxes, "LEAST_VOXELS", (edge_boxes.LEAST_VOXELS, 1)[seed // 3 % 2])
        for module in (open_caps, exact_voxels):
            # Many groups at one voxel, too.
            patch.setattr(module, "groups_at_work", lambda _: (2, 40)[seed // 17 % 2])
        patch.setattr(open_caps, "AROUND", ((1, 0), (0, 1), (1, 1))[seed // 13 % 3])
        patch.setattr(column_sums, "BY_EIGHTS", seed % 4 > 0)
        fast, slow = both(index, grid_about(mesh.vertices, shape, turned, seed))
    assert torch.equal(fast.values, slow.values)
    assert fast.ambiguous_voxels == slow.ambiguous_voxels


@settings(max_examples=30)
@given(
    mesh=dirt, shape=st.tuples(*[st.integers(1, 30)] * 3), turned=st.booleans(), last=st.sampled_from([0, 1, 2, 3]),
    seed=strategies.seeds,
)  # fmt: skip
def test_the_faces_themselves_for_caps(mesh, shape, turned, last, seed):
    """As meshes with many boundary edges have them, if those are more than the faces."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sdm.engine.structure.sizes, "MOST_BOUNDARY_EDGES", 0)
        patch.setattr(sdm.engine.structure.sizes, "MOST_FOR_GROUPS", 0)
        patch.setattr(column_sums, "BY_EIGHTS", seed % 2 > 0)
        patch.setattr(open_caps, "SUMMED", ((last, np.inf, np.inf),) if last > 0 else ())
        patch.setitem(edge_boxes.MOST_EDGES, "cpu", np.inf if last == 3 else 0)
        patch.setattr(column_sums, "FACES_AN_EDGE", dict.fromkeys(("cuda", "cpu"), (0, np.inf)))
        index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu")
        fast, slow = both(index, grid_about(mesh.vertices, shape, turned, seed))
    sizes = index._structure.sizes
    assert sizes.caps == min(sizes.edges, sizes.faces)
    assert torch.equal(fast.values, slow.values)
    assert fast.ambiguous_voxels == slow.ambiguous_voxels


@settings(max_examples=24)
@given(mesh=dirt, shape=st.tuples(*[st.integers(1, 20)] * 3), seed=strategies.seeds)
def test_signs_are_those_of_the_sum_over_all_faces(mesh, shape, seed):
    """In float64, where that is further than 1e-3 from what decides."""
    grid = grid_about(mesh.vertices, shape, False, seed)
    found = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cpu").signed_distance_map(grid)
    winding = Brute(mesh.vertices, mesh.faces).winding_number(grid.points().reshape(-1, 3).numpy())
    values, off = found.values.numpy().reshape(-1), np.abs(winding - 0.5)
    # On the surface there is no sign.
    size = np.abs(grid.points().numpy()).max() + np.abs(mesh.vertices).max()
    away = np.abs(values) > 1e-5 * size
    assert ((values < 0) == (winding > 0.5))[away & (off > 1e-3)].all()
    fewest, most = (np.count_nonzero(off[away] < 0.25 + room) for room in (-1e-3, 1e-3))
    assert found.ambiguous_voxels is not None
    assert fewest <= found.ambiguous_voxels <= most + np.count_nonzero(~away)


@pytest.mark.parametrize("share", [0.03, 0.3])
def test_a_batch_has_the_bits_of_its_meshes(monkeypatch, share):
    mesh = torn(share, 4)
    batch = torch.tensor(np.stack([mesh.vertices, 0.5 * mesh.vertices + 0.3, mesh.vertices @ np.diag([1, 0.4, 0.7])]))
    batch, faces = batch.float(), torch.tensor(mesh.faces)
    grid = sdm.Grid((-1.1, -1.1, -1.1), (0.1, 0.11, 0.09), (35, 21, 23))
    together = sdm.signed_distance_maps(batch, faces, grid, device="cpu")
    for vertices, values in zip(batch, together, strict=True):
        assert torch.equal(both(sdm.MeshIndex(sdm.TriangleMesh(vertices, faces), "cpu"), grid)[1].values, values)


@pytest.mark.gpu
@pytest.mark.parametrize("share", [0.01, 0.1, 0.3])
def test_a_gpu_has_the_same_bits_by_either_way(monkeypatch, share):
    mesh = torn(share, 5)
    index = sdm.MeshIndex(sdm.TriangleMesh(*mesh), "cuda")
    for seed in range(7):
        # Large boxes first, as large maps have them, or small ones.
        monkeypatch.setitem(open_caps.MOST_FIRST, "cuda", (16, 8192)[seed % 2])
        # What boxes of these sizes leave in doubt is summed up over all edges.
        monkeypatch.setattr(open_caps, "SUMMED", ((1 + seed % 3, np.inf, np.inf),))
        monkeypatch.setitem(every_voxel.MOST_SUMS, "cuda", np.inf if seed == 3 else 0)
        monkeypatch.setitem(edge_boxes.MOST_EDGES, "cuda", np.inf if seed > 3 else 0)
        monkeypatch.setattr(column_sums, "FACES_AN_EDGE", dict.fromkeys(("cuda", "cpu"), (0, np.inf)))
        fast, slow = both(index, grid_about(mesh.vertices, (70, 61, 83), seed in (2, 3, 6), seed))
        assert torch.equal(fast.values, slow.values)
        assert fast.ambiguous_voxels == slow.ambiguous_voxels
