"""The quick look tells a plain mesh from one to say something about, also where faces share no vertices."""

from __future__ import annotations

import numpy as np
import pytest

from sdm.bench.common.mesh_formulas import Arrays, hemisphere, inverted, joined, moved, sphere, torus
from sdm.core.mesh import TriangleMesh
from sdm.inspect.quick_look import look_at


def loose(mesh: Arrays) -> Arrays:
    """The same triangles, each with corners of its own."""
    vertices, faces = mesh
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)


BALL, FAR = sphere(12), (5.0, 0, 0)
MESHES = {
    "a ball": (BALL, True),
    "a hemisphere": (hemisphere(), True),
    "a ball and a torus": (joined(BALL, moved(torus(2000), 1.0, FAR)), True),
    "a ball inside out": (inverted(BALL), False),
    "a small ball inside out": (joined(BALL, moved(inverted(BALL), 0.1, FAR)), False),
    "a small hemisphere inside out": (joined(BALL, moved(inverted(hemisphere()), 0.1, FAR)), False),
    "a sheet there and back": (joined(hemisphere(), inverted(hemisphere())), False),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("shared", [True, False], ids=["shared vertices", "own vertices"])
def test_components_that_face_inward_are_seen(name, shared):
    arrays, plain = MESHES[name]
    mesh = TriangleMesh(*(arrays if shared else loose(arrays)))
    assert look_at(mesh).is_plain(mesh) == plain


def test_halves_that_meet_in_place_alone_are_one_component():
    vertices, faces = sphere(12)
    upper = (vertices[faces][:, :, 2] > -1e-6).all(1)
    halves = joined((vertices, faces[upper]), (vertices, faces[~upper]))
    mesh = TriangleMesh(*halves)
    assert look_at(mesh).is_plain(mesh)
    turned = TriangleMesh(halves[0], halves[1][:, ::-1].copy())
    assert not look_at(turned).is_plain(turned)
