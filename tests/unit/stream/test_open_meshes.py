"""Meshes with holes and unmerged vertices: the topology is found once, and no sample depends on its neighbours."""

from __future__ import annotations

import torch

import sdm
from sdm.core.demo_mesh import demo_mesh
from sdm.core.mesh import TriangleMesh
from sdm.shapes import Group, MeshFolder
from sdm.stream import SDMStream, known_boundaries


def meshes():
    whole = demo_mesh(rings=41, segments=16, cap_rings=3)
    # As an STL file holds it: every triangle has vertices of its own.
    torn = TriangleMesh(whole.vertices[whole.faces.long().reshape(-1)], torch.arange(3 * len(whole)).reshape(-1, 3))
    open_ = TriangleMesh(whole.vertices, whole.faces[:-20])
    return [whole, torn, open_]


def test_no_sample_depends_on_its_batch():
    family = MeshFolder(meshes(), open_meshes="keep")
    grid = family.grid(10)
    source = SDMStream(family, grid, 12, device="cpu")
    batch = source.sample(list(range(12)))
    assert len(batch.theta[:, 0].floor().unique()) == 3
    for number in range(12):
        assert torch.equal(source.sample(number).sdm[0], batch.sdm[number])
        group = next(iter(family.groups(batch.theta[number : number + 1])))
        alone = sdm.signed_distance_map(TriangleMesh(group.vertices[0], group.faces), grid, device="cpu")
        assert torch.equal(batch.sdm[number, 0], alone.values)


class Remaking(MeshFolder):
    """Its faces are new for each batch."""

    def groups(self, theta, host=None):
        for group in super().groups(theta, host):
            yield Group(group.rows, group.vertices, group.faces.clone())


def test_nothing_is_kept_of_faces_that_are_gone():
    family = Remaking(meshes(), open_meshes="keep")
    plain = MeshFolder(family.meshes, open_meshes="keep")
    grid = plain.grid(8)
    source = SDMStream(family, grid, 4, device="cpu")
    for number in range(3):
        expected = SDMStream(plain, grid, 4, device="cpu").sample(number).sdm
        assert torch.equal(source.sample(number).sdm, expected)
    assert len(source.maker._topology._known) == 0


def test_topology_is_found_once(monkeypatch):
    family = MeshFolder(meshes(), open_meshes="keep")
    source = SDMStream(family, family.grid(8), 4, device="cpu")

    def asked_again(*_: object) -> None:
        raise AssertionError("the boundary was looked for during a batch")

    monkeypatch.setattr(known_boundaries, "boundary_edges", asked_again)
    monkeypatch.setattr("sdm.engine.acceleration.boundary_edges", asked_again)
    assert source.sample(list(range(12))).sdm.shape == (12, 1, 8, 8, 8)
