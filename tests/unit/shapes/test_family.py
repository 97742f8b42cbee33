"""The protocol: a user's own family, grids, and what is kept between calls."""

from __future__ import annotations

import pickle
import re
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

import sdm.shapes
from sdm.errors import MeshError
from sdm.shapes import Cochlea, Cuboid, Family, Parameter

README = Path(sdm.shapes.__file__).parent / "README.md"


def blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)


def test_examples_of_the_readme_run():
    for block in blocks():
        exec(compile(block, str(README), "exec"), {})


def test_a_family_of_ones_own():
    names: dict = {}
    own = next(b for b in blocks() if "class Torus" in b)
    assert len([line for line in own.splitlines() if line.strip()]) <= 30
    exec(own, names)
    family: Family = names["Torus"]()
    mesh = family.mesh([2.5, 0.5])
    vertices, faces = mesh.numpy()
    solid = trimesh.Trimesh(vertices, faces, process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(2 * 9.8696 * 2.5 * 0.25, rel=1e-2)
    assert family.sample(3, device="cpu").shape == (3, 2)
    (group,) = family.groups(family.sample(3, device="cpu"))
    assert group.vertices.shape[0] == 3
    with pytest.raises(MeshError, match="R of theta is 9; torus takes 2 to 3 mm"):
        family.mesh([9, 0.5])


def test_grid_holds_every_shape():
    family = Cochlea(500)
    grid = family.grid(32)
    low, high = torch.tensor(grid.origin), torch.tensor(grid.origin) + 31 * grid.spacing[0]
    vertices = family.vertices(family.sample(200, seed=9, device="cpu"))
    assert bool((vertices > low).all())
    assert bool((vertices < high).all())


def test_faces_are_the_same_tensor_each_time():
    family = Cuboid()
    assert family.faces is family.faces
    assert family.faces.dtype == torch.int32


def test_mesh_takes_one_sample():
    family = Cuboid()
    with pytest.raises(MeshError, match="theta holds 2 samples"):
        family.mesh(family.sample(2, device="cpu"))


def test_pickle():
    family = Cochlea(500)
    theta = family.sample(2, device="cpu")
    expected = family.vertices(theta)
    again = pickle.loads(pickle.dumps(family))
    assert torch.equal(again.vertices(theta), expected)
    assert again.fingerprint == family.fingerprint


def test_fingerprint_tells_families_apart():
    prints = {Cochlea(500).fingerprint, Cochlea(600).fingerprint, Cuboid().fingerprint, Cuboid(shift=1.0).fingerprint}
    assert len(prints) == 4
    assert Cochlea(500).fingerprint == Cochlea(500).fingerprint


def test_parameters_make_sense():
    with pytest.raises(MeshError, match="length runs from 2 to 1"):
        Parameter("length", 2, 1)


def test_parameters_may_be_given_as_numbers_of_any_kind():
    found = Parameter("x", np.float32(0.5), torch.tensor(2.0))  # pyright: ignore[reportArgumentType]
    assert repr(found) == repr(Parameter("x", 0.5, 2.0))
    assert repr(Parameter("x", 1, 2)) == "Parameter(name='x', low=1, high=2, unit='1')"


def test_what_inference_mode_leaves_behind_can_be_trained_with():
    with torch.inference_mode():
        family = Cuboid(triangles=108)
        family.vertices(family.sample(2, device="cpu"))
    unit = torch.full((1, len(family.parameters)), 0.5, requires_grad=True)
    theta = family.from_unit(unit)
    (family.vertices(theta).sum() + family.to_unit(theta).sum()).backward()
    assert unit.grad is not None
    assert not family.faces.is_inference()
