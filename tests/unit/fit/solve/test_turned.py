"""Shapes turned far, and mirrored ones."""

from __future__ import annotations

import math

import pytest
import torch

import sdm
from sdm.errors import SDMError
from sdm.fit import ExactBackend, Scanner, State, random_state, simulate
from sdm.fit.model.backends import make_backends
from sdm.fit.model.pose import rotation_from_vector, vector_from_rotation
from sdm.fit.model.scaled_family import MirroredFamily
from sdm.fit.solve.initial import Candidate, all_turns, candidates, coarser, middle_of, of_other_rotations
from sdm.shapes import Cochlea


def test_rotations_are_all_around():
    turns = torch.stack([torch.eye(3).double(), *all_turns(1.0, torch.device("cpu"))])
    assert len(turns) == 60
    for seed in range(50):
        vector = torch.randn(3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        other = rotation_from_vector(3 * vector / vector.norm())
        angles = [float(vector_from_rotation(r.T @ other).norm()) for r in turns]
        assert min(angles) < math.radians(45)
    assert len(all_turns(0.1, torch.device("cpu"))) == 0


def test_one_candidate_a_rotation():
    zero = torch.zeros(3).double()
    same, other = torch.eye(3).double(), rotation_from_vector(torch.tensor([0.5, 0, 0]).double())
    found = [Candidate(State(zero, r, zero, zero), e) for r, e in ((same, 0.9), (same, 0.8), (other, 0.7))]
    assert [c.explained for c in of_other_rotations(found)] == [0.9, 0.7]


def test_a_mirrored_shape_turned_by_ninety_degrees():
    family = MirroredFamily(Cochlea(1_000))
    theta = torch.tensor([[(p.low + p.high) / 2 for p in family.parameters]])
    mesh = family.mesh(theta)
    a, b, c = mesh.vertices[mesh.faces.long()].double().unbind(1)
    assert float((a * torch.linalg.cross(b, c)).sum()) > 0
    backend = ExactBackend(family, "cpu")
    truth = random_state(backend, seed=5, edge=0.25, turn=0.01)
    turned = rotation_from_vector(torch.tensor([0.0, math.pi / 2, 0.0], dtype=torch.float64))
    truth = State(truth.theta, turned, truth.translation, truth.centre)
    n, h = 18, 0.8
    grid = sdm.Grid((truth.translation - h * (n - 1) / 2).tolist(), (h,) * 3, (n,) * 3)
    image = simulate(backend, truth, Scanner(spacing=h, blur=0.3, noise=50), seed=1, grid=grid)
    small, wide = coarser(image.values.double(), grid)
    expected = State(truth.theta, torch.eye(3, dtype=torch.float64), middle_of(grid), truth.centre)
    found = of_other_rotations(candidates(backend, small, wide, expected, all_turns(1.0, torch.device("cpu"))))
    # What the steps begin at: one of the best is turned nearly enough for them.
    near = [c for c in found[:6] if vector_from_rotation(truth.rotation.T @ c.state.rotation).norm() < math.radians(45)]
    assert near
    assert torch.dist(near[0].state.translation, truth.translation) < 3
    assert make_backends("exact", triangles=1_000, device="cpu", mirror=True)[0].parameters == family.parameters
    with pytest.raises(SDMError, match="mirrored"):
        make_backends("hybrid", device="cpu", mirror=True)
