"""Points, batches, slabs and streams of which nothing is inside: one warning, and none where all is as it should be."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

import sdm
from sdm.errors import SDMWarning

BALL = trimesh.creation.icosphere(2, radius=20)
AT = np.array([-40.0, -30, 50])
# As of an image in RAS.
GRID = sdm.Grid((-72, -62, 18), (4, 4, 4), (17, 17, 17))
POINTS = (np.random.default_rng(0).uniform(-30, 30, (500, 3)) + AT).astype(np.float32)
DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)]


def ball(*scale: float, reverse: bool = False, shift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    turn = reverse != (np.prod(scale) < 0)
    faces = BALL.faces[:, ::-1] if turn else BALL.faces
    return ((BALL.vertices + AT) * scale + shift).astype(np.float32), np.ascontiguousarray(faces, np.int32)


def points(mesh: Any, device: str) -> None:
    sdm.signed_distance(mesh, POINTS, device=device)


def closest(mesh: Any, device: str) -> None:
    sdm.signed_distance(mesh, POINTS, return_closest=True, device=device)


def index(mesh: Any, device: str) -> None:
    index = sdm.MeshIndex(mesh, device)
    for _ in range(3):
        index.signed_distance(POINTS)


def several(mesh: Any, device: str) -> None:
    sdm.signed_distances([ball(1, 1, 1), mesh], [POINTS, POINTS], device=device)


def batch(mesh: Any, device: str) -> None:
    vertices, faces = (torch.from_numpy(part).to(device) for part in mesh)
    for _ in range(3):
        sdm.signed_distance_maps(torch.stack([vertices, vertices + 1]), faces, GRID, device=device)
        if device == "cuda":
            torch.cuda.synchronize()


def slabs(mesh: Any, device: str) -> None:
    for _, _, values in sdm.MeshIndex(mesh, device).slabs(GRID):
        values.cpu()


WRONG = {
    "LPS": (ball(-1, -1, 1), "negate x and y"),
    "metres": (ball(1e-3, 1e-3, 1e-3), "multiply the vertices by 1000"),
    "inside out": (ball(1, 1, 1, reverse=True), "inside out"),
    "elsewhere": (ball(1, 1, 1, shift=500), "wholly outside the grid's"),
}


def said(call: Callable[[], None]) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SDMWarning)
        call()
    assert all(one.filename == __file__ for one in caught)
    return [str(one.message) for one in caught]


@pytest.mark.parametrize("ask", [points, closest, index, several, batch, slabs])
def test_a_mesh_that_is_where_it_should_be(ask):
    assert said(lambda: ask(ball(1, 1, 1), "cpu")) == []


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("ask", [points, closest, index, several, batch, slabs])
def test_one_warning(ask, name):
    mesh, words = WRONG[name]
    found = said(lambda: ask(mesh, "cpu"))
    if name == "elsewhere" and ask in (points, closest, index, several):
        # Points may well lie far from a mesh.
        assert found == []
    else:
        assert len(found) == 1
        assert words in found[0]
        assert ask is not several or found[0].startswith("mesh 1: ")


@pytest.mark.gpu
@pytest.mark.parametrize("name", ["LPS", "metres", "inside out", "elsewhere"])
def test_batches_on_a_gpu_are_looked_at_by_a_later_call(name):
    mesh, words = WRONG[name]
    (found,) = said(lambda: batch(mesh, "cuda"))
    assert words in found


@pytest.mark.gpu
def test_slabs_on_a_gpu():
    (found,) = said(lambda: slabs(ball(-1, -1, 1), "cuda"))
    assert "negate x and y" in found
    assert said(lambda: slabs(ball(1, 1, 1), "cuda")) == []


@pytest.mark.gpu
def test_nothing_waits_for_a_gpu():
    family = sdm.shapes.Ellipsoid()
    stream = iter(sdm.SDMStream(family, family.grid(16), batch_size=2, seed=0, device="cuda", prefetch=1))
    next(stream)
    vertices, faces = (torch.from_numpy(part).cuda() for part in ball(1, 1, 1))
    sdm.signed_distance_maps(vertices[None], faces, GRID, device="cuda")
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        for _ in range(4):
            next(stream)
            sdm.signed_distance_maps(vertices[None], faces, GRID, device="cuda")
    finally:
        torch.cuda.set_sync_debug_mode("default")


@pytest.mark.parametrize("device", DEVICES)
def test_a_stream_on_a_grid_elsewhere(device):
    family = sdm.shapes.Ellipsoid()

    def take(grid: sdm.Grid | int) -> None:
        stream = iter(sdm.SDMStream(family, grid, batch_size=2, seed=0, device=device))
        for _ in range(6):
            next(stream).sdm.cpu()

    (found,) = said(lambda: take(sdm.Grid((500, 0, 0), (1, 1, 1), (8, 8, 8))))
    assert found.startswith("ellipsoid: ")
    assert "outside the grid's" in found
    assert said(lambda: take(16)) == []


def test_silence_where_it_was_asked_for():
    reversed_ball = ball(1, 1, 1, reverse=True)
    assert said(lambda: sdm.signed_distance(reversed_ball, POINTS, device="cpu", sign="none")) == []
    assert said(lambda: sdm.MeshIndex(reversed_ball, "cpu", warn=False).signed_distance(POINTS)) == []
    # A few points make no box.
    assert said(lambda: sdm.signed_distance(ball(-1, -1, 1), POINTS[:5], device="cpu")) == []
    vertices = torch.from_numpy(reversed_ball[0]).requires_grad_()
    assert said(lambda: sdm.signed_distance((vertices, reversed_ball[1]), POINTS, device="cpu")) == []


def test_points_beside_a_mesh():
    assert said(lambda: sdm.signed_distance(ball(1, 1, 1), POINTS + 100, device="cpu")) == []
