"""Samples of a mesh: exact, by the law, and pure functions of seed, name and number."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.core.normalization import Normalization
from sdm.errors import MeshError, SDMError
from sdm.sampling import OCCUPANCY, PAPER, RELEASED, SampleLaw, sample

TALL = trimesh.creation.icosphere(2)
TALL.apply_scale([1.0, 1.5, 2.0])
MESH = sdm.TriangleMesh(TALL.vertices + 5, TALL.faces, "tall")


def test_distances_are_the_engines(device):
    found = sample(MESH, 3000, device=device, closest=True)
    assert found.normalization == Normalization.of(MESH, "sphere")
    unit = found.normalization.normalised(MESH)
    alone, hit = sdm.signed_distance(unit, found.points, return_closest=True, device=device)
    torch.testing.assert_close(found.distances, alone, rtol=0, atol=0)
    torch.testing.assert_close(found.closest, hit.points, rtol=0, atol=0)
    assert torch.equal(found.occupancies, alone < 0)
    outward = ((found.points - found.closest) * found.normals).sum(1)
    clear = alone.abs() > 1e-3
    assert torch.equal(outward[clear] < 0, alone[clear] < 0)


def test_the_laws():
    for law, near, box in ((PAPER, 475_000, 25_000), (RELEASED, 470_000, 30_000), (OCCUPANCY, 0, 500_000)):
        kinds = law.kinds(torch.arange(500_000))
        assert [int((kinds == kind).sum()) for kind in (0, 1)] == [near, box]
    # On a flat sheet, the offset across it has the law's deviations.
    sheet = sdm.TriangleMesh([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    found = sample(sheet, 40_000, law=SampleLaw(), normalize=None, sign="none", device="cpu", orient="keep")
    near = found.kinds == 0
    for start, deviation in enumerate(PAPER.deviations):
        across = found.points[start::2][near[start::2], 2]
        assert abs(float(across.std()) / deviation - 1) < 0.03
        assert abs(float(across.mean())) < 0.03 * deviation
    anywhere = found.points[found.kinds == 1]
    assert anywhere.abs().max() <= 1
    assert np.allclose(anywhere.std(0), 1 / np.sqrt(3), atol=0.03)


def test_on_the_surface_points_are_even_by_area():
    law = SampleLaw(near=0, uniform=0, surface=1, deviations=())
    found = sample(MESH, 20_000, law=law, device="cpu", closest=True)
    assert (found.distances == 0).all()
    unit = found.normalization.normalised(MESH)
    assert float(sdm.signed_distance(unit, found.points, device="cpu").abs().max()) < 1e-6
    vertices, faces = unit.numpy()
    areas = trimesh.Trimesh(vertices, faces, process=False).area_faces
    upper = vertices[faces].mean(1)[:, 2] > 0.3
    share = float((found.points[:, 2] > 0.3).float().mean())
    assert abs(share - areas[upper].sum() / areas.sum()) < 0.02
    torch.testing.assert_close(found.closest, found.points)
    assert np.allclose(found.normals.norm(dim=1), 1, atol=1e-5)


def test_a_sample_depends_on_seed_name_and_number_alone():
    whole = sample(MESH, 600, seed=3, device="cpu")
    again = sample(MESH, 600, seed=3, device="cpu")
    part = sample(MESH, 150, seed=3, first=200, device="cpu")
    assert torch.equal(whole.points, again.points)
    assert torch.equal(part.points, whole.points[200:350])
    assert torch.equal(part.distances, whole.distances[200:350])
    for other in ({"seed": 4}, {"seed": 3, "name": "b/tall"}):
        assert not torch.equal(sample(MESH, 600, device="cpu", **other).points, whole.points)


def test_a_flood_gives_sheets_an_inside():
    """A ball whose faces look all ways has the signs of the ball."""
    flip = np.random.default_rng(0).random(len(TALL.faces)) < 0.5
    mixed = np.where(flip[:, None], TALL.faces[:, ::-1], TALL.faces)
    mixed = sdm.TriangleMesh(TALL.vertices + 5, mixed, "tall")
    law = SampleLaw(near=9, uniform=1, deviations=(0.05, 0.001))
    found = sample(mixed, 4000, law=law, sign="flood", device="cpu", orient="keep")
    right = sdm.signed_distance(Normalization.of(MESH, "sphere").normalised(MESH), found.points, device="cpu")
    torch.testing.assert_close(found.distances.abs(), right.abs(), rtol=0, atol=0)
    differ = (found.distances < 0) != (right < 0)
    assert int(differ.sum()) <= found.unsure
    assert found.unsure < 8


def test_what_cannot_be_is_refused():
    flat = sdm.TriangleMesh([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    with pytest.raises(MeshError, match="zero area"):
        sample(flat, 10, device="cpu", orient="keep")
    with pytest.raises(SDMError, match="at least 1"):
        sample(MESH, 0)
    for bad in ({"near": -1}, {"near": 0, "uniform": 0}, {"deviations": (float("nan"),)}, {"deviations": ()}):
        with pytest.raises(SDMError, match="no law"):
            SampleLaw(**bad)
