"""Every family of the registry: closed surfaces, one reference, transforms, probes; nobody else names a class."""

from __future__ import annotations

import inspect
import pickle
import re

import pytest
import torch
import trimesh

from sdm import shapes
from sdm.cli.commands.generate import generate
from sdm.dataset.family_registry import FAMILIES
from sdm.errors import MeshError
from sdm.fit.model.jacobian import vertices_with_jacobian
from sdm.shapes import Family, families, make_family


@pytest.fixture(params=families)
def family(request: pytest.FixtureRequest) -> Family:
    return families[request.param].example()


def test_the_registry_has_every_public_family():
    public = {value for value in vars(shapes).values() if inspect.isclass(value) and issubclass(value, Family)}
    assert set(families.values()) == public - {Family}
    assert all(name == family.name for name, family in families.items())


def test_families_that_need_no_files_are_named_by_commands():
    assert generate.__doc__
    assert all(name in generate.__doc__ for name in FAMILIES)
    assert set(families) - set(FAMILIES) == {"mesh-folder", "shape-model"}


def test_no_module_outside_shapes_names_a_class(root):
    names = re.compile(r"\b(" + "|".join(family.__name__ for family in families.values()) + r")\b")
    sources = [p for p in (root / "sdm").glob("*/**/*.py") if p.parts[len(root.parts) + 1] not in ("shapes", "bench")]
    assert len(sources) > 100
    assert not [str(path) for path in sources if names.search(path.read_text())]


def test_an_unknown_name_is_refused():
    with pytest.raises(MeshError, match="there is no family called 'torus'; use cochlea, "):
        make_family("torus")


def test_samples_are_closed_and_inside_the_grid(family):
    grid = family.grid(16)
    low = torch.tensor(grid.origin)
    high = low + torch.tensor(grid.spacing) * (torch.tensor(grid.shape) - 1)
    theta = family.sample(6, device="cpu")
    for group in family.groups(theta, theta):
        for vertices in group.vertices:
            solid = trimesh.Trimesh(vertices.numpy(), group.faces.numpy(), process=False)
            solid.merge_vertices()
            assert solid.is_watertight
            assert solid.volume > 0
            assert bool((vertices > low).all())
            assert bool((vertices < high).all())


def test_reference_vertices_are_the_vertices(family):
    theta = family.sample(3, device="cpu")
    torch.testing.assert_close(family.reference_vertices(theta.double()).float(), family.vertices(theta))


def test_fits_have_derivatives_of_families_without_files(family):
    if family.needs_files:
        pytest.skip("a folder's meshes are for training")
    theta = family.sample(1, seed=3, device="cpu")[0].double()
    vertices, jacobian = vertices_with_jacobian(family, theta)
    step = 1e-6 * torch.eye(len(theta), dtype=torch.float64)[0]
    ahead, behind = (family.reference_vertices((theta + way * step)[None])[0] for way in (1, -1))
    torch.testing.assert_close(jacobian[:, :, 0], (ahead - behind) / 2e-6, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(vertices, family.reference_vertices(theta[None])[0])


def test_transforms_are_of_families_that_place_meshes(family):
    theta = family.sample(4, device="cpu")
    found = family.sample_transforms(theta)
    assert (found is not None) == family.places_meshes
    if found is not None:
        assert found.shape == (4, 4, 4)
        assert found.dtype == torch.float64
        assert bool((torch.linalg.det(found) > 0).all())


def test_probes_touch_all_faces_and_samples_cost_no_more(family):
    theta = family.sample(64, device="cpu")
    probed = {g.faces.data_ptr() for probe in family.probes(theta[:2]) for g in family.groups(probe, probe)}
    assert {g.faces.data_ptr() for g in family.groups(theta, theta)} <= probed
    assert 1 <= family.triangles_per_sample <= len(family.triangles)
    assert family.rejected == ()


def test_other_numbers_of_triangles_are_of_the_same_shapes(family):
    other = family.with_triangles(2_000)
    if other is not None:
        assert len(other.triangles) > len(family.triangles)
        assert other.parameters == family.parameters
        torch.testing.assert_close(torch.stack(other.bounds()), torch.stack(family.bounds()), rtol=0.05, atol=0.1)


def test_pickled_families_are_the_same(family):
    again = pickle.loads(pickle.dumps(family))
    assert again.fingerprint == family.fingerprint
    assert type(family).example().fingerprint == family.fingerprint
