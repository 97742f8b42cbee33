"""Shapes turned far, and mirrored ones."""

from __future__ import annotations

import math

import torch

import sdm
from sdm.fit import ExactBackend, FitOptions, Scanner, State, fit_shape, random_state, simulate
from sdm.fit.model.backends import make_backends
from sdm.fit.model.pose import rotation_from_vector, vector_from_rotation
from sdm.fit.model.scaled_family import MirroredFamily
from sdm.fit.solve.initial import Candidate, all_turns, middle_of, of_other_rotations
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
    options = FitOptions(blur=0.3, fine=0.4, turn=1.0, starts=2)
    found = fit_shape(image.values, grid, backend, options=options)
    assert found.trusted, found.diagnosis.problems
    assert float((found.state.theta - truth.theta)[0].abs()) < 0.1
    assert float(vector_from_rotation(truth.rotation.T @ found.state.rotation).norm()) < 0.1
    assert torch.dist(middle_of(grid), found.state.translation) < 0.5
    assert make_backends("exact", triangles=1_000, device="cpu", mirror=True)[0].parameters == family.parameters
