"""Builds: of meshes never seen before, bit for bit that of known ones; of too many triangles, refused."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import sdm
from sdm.bench.common.dirty_meshes.by_code import sheets, torn, turned
from sdm.bench.common.meshes import cube, load_case, sphere, torus
from sdm.engine.acceleration import build
from sdm.engine.first_build import build_first
from sdm.engine.maps import _queue_guessed_map
from sdm.engine.ops import structure_slab
from sdm.engine.plan_override import plan_override
from sdm.errors import MeshError
from sdm.kernels.topology import boundary_loops
from sdm.topology import device_joining, guesses
from sdm.topology.boundary_edges import boundary_edges
from sdm.topology.face_pairing import is_known
from tests.helpers.same_bits import assert_same_bits


@pytest.mark.parametrize("name", ["torus-500", "open hemisphere", "random soup", "unmerged sphere", "three sheets"])
def test_the_same_structure(name):
    case = load_case(name)
    vertices, faces = torch.from_numpy(case.vertices), torch.from_numpy(case.faces)
    found, topology = build_first(vertices, faces)
    assert is_known(faces, vertices.shape[0])
    expected = build(vertices[None], faces.clone())
    assert found.sizes == expected.sizes
    assert topology.boundary.shape[0] == expected.sizes.edges
    for array in ("corners", "lattice", "face"):
        assert np.array_equal(getattr(found.view.tree, array).numpy(), getattr(expected.view.tree, array).numpy())
    grid = sdm.Grid([-1.1] * 3, [0.2] * 3, [12] * 3)
    for ours, theirs in zip(structure_slab(found, grid, 0, 12), structure_slab(expected, grid, 0, 12), strict=True):
        assert torch.equal(ours, theirs)


@pytest.mark.parametrize("bad", [-1, 1000])
def test_a_face_out_of_range_is_refused(bad):
    case = load_case("torus-500")
    faces = torch.from_numpy(case.faces).clone()
    faces[7, 1] = bad
    with pytest.raises(MeshError, match=f"uses vertex {bad}, but the"):
        build_first(torch.from_numpy(case.vertices), faces)
    assert not is_known(faces, len(case.vertices))


def test_too_many_triangles():
    vertices, faces = (torch.tensor(array) for array in cube())
    batch = vertices[None].expand(10_000_000, -1, -1)
    with pytest.raises(MeshError, match="10,000,000 meshes of 12 triangles are more than the 100,000,000"):
        build(batch, faces)


@pytest.mark.parametrize("name", ["open hemisphere", "moebius strip", "random soup", "unmerged sphere", "three sheets"])
def test_a_boundary_joined_on_the_device(monkeypatch, name):
    """As a GPU does it."""
    case = load_case(name)
    vertices, faces = torch.from_numpy(case.vertices), torch.from_numpy(case.faces)
    expected, topology = build_first(vertices, faces.clone())
    monkeypatch.setattr(device_joining, "JOINING_DEVICES", ("cpu",))
    joined = []
    plain = device_joining.remember_joined
    monkeypatch.setattr(device_joining, "remember_joined", lambda *given: joined.append(1) or plain(*given))
    found, ours = build_first(vertices, faces)
    assert joined
    assert found.sizes == expected.sizes
    assert torch.equal(ours.boundary, topology.boundary)
    # Caps of a soup are its faces, and loops that meet are cut otherwise.
    if name in ("open hemisphere", "random soup"):
        assert torch.equal(ours.caps, topology.caps)
    grid = sdm.Grid([-1.1] * 3, [0.2] * 3, [12] * 3)
    for one, other in zip(structure_slab(found, grid, 0, 12), structure_slab(expected, grid, 0, 12), strict=True):
        assert torch.equal(one, other)
    # The next call about the same faces finds the same boundary.
    assert torch.equal(boundary_edges(vertices, faces), topology.boundary)


def loose(mesh):
    """Each triangle with vertices of its own, as in an STL file."""
    vertices, faces = mesh
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)


NEW_MESHES = {
    "closed": lambda: torus(900),
    "loops that meet": lambda: torn(torus(600), 0.3),
    "many boundary edges": lambda: torn(torus(5000), 0.3),
    "closed, loose": lambda: loose(sphere(9)),
    "a hole, loose": lambda: loose((cube()[0], cube()[1][1:])),
    "sheets": lambda: sheets(9),
    # More boundary edges than faces, which are its caps then.
    "half its faces turned": lambda: turned(torus(900), 0.5),
}


@pytest.mark.filterwarnings("ignore::sdm.SDMWarning")
@pytest.mark.parametrize("name", NEW_MESHES)
@pytest.mark.parametrize("most_compared", [boundary_loops.MOST_COMPARED, 0])
def test_a_first_map_by_the_steps_of_a_gpu(monkeypatch, name, most_compared):
    monkeypatch.setattr(boundary_loops, "MOST_COMPARED", most_compared)
    monkeypatch.setattr(device_joining, "JOINING_DEVICES", ("cpu",))
    monkeypatch.setattr(guesses, "last_open", type(guesses.last_open)())
    vertices, faces = (torch.from_numpy(array) for array in NEW_MESHES[name]())
    mesh = sdm.TriangleMesh(vertices.clone(), faces.clone())
    grid = sdm.Grid.around(mesh, 24)
    with plan_override(slice_factors=(1,)):
        expected = sdm.signed_distance_map(mesh, grid, device="cpu")
        for _ in range(2):
            structure, topology = build_first(vertices, faces)
            values, ambiguous = structure_slab(structure, grid, 0, grid.shape[0])
            assert_same_bits(values[0], expected.values, name)
            assert ambiguous.item() == expected.ambiguous_voxels
        # And by those that are recorded, for meshes with as many of everything.
        if (numbers := guesses.guess(faces, vertices.shape[0])) != guesses.CLOSED:
            flags: list[torch.Tensor] = []
            again, ambiguous = _queue_guessed_map(numbers, grid, flags.append, vertices, faces)
            assert not flags[0].any()
            assert_same_bits(again[0], expected.values, name)
            assert ambiguous.item() == expected.ambiguous_voxels
    assert (topology.boundary.shape[0] == 0) == name.startswith("closed")
