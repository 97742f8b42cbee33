"""Nonsense for each argument of public calls: objects, empty containers, text for numbers, numbers for paths."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

import sdm
from sdm.core.given_values import real, whole
from sdm.errors import SDMError

MESH = sdm.TriangleMesh(
    [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], "tetrahedron"
)
GRID = sdm.Grid.around(MESH, 5)
POINTS = np.zeros((2, 3))
# Nothing that any argument takes.
OBJECTS = (object(), {}, [], 1j, b"x", lambda: 0)
NUMBERS = (*OBJECTS, "nonsense", float("nan"), -1, torch.zeros(2), 10**400)
LENGTHS = (*NUMBERS, float("inf"))
PATHS = (*OBJECTS[:-2], 3, None, MESH, "", "null\0.npz", "null\0.ply")
NO_MESHES = (object(), 1j, None, 3, "nonsense", GRID, POINTS, (POINTS, None), (POINTS[:0], np.zeros((0, 3), int)))
MESHES = (*OBJECTS, *NO_MESHES)
GRIDS = (*OBJECTS, None, "nonsense", float("nan"), -3, 0, [1, 2], ["a", "b", "c"], MESH)
DEVICES = (*OBJECTS[:-2], 2.5, True, "nonsense", "cuda:99", MESH)
CHOICES = (*OBJECTS, 3, "nonsense")
POINT_SETS = (*OBJECTS, None, 3, "nonsense", [1, 2], ["a", "b", "c"], MESH)

CALLS: dict[str, tuple[Callable[[Any], Any], tuple[Any, ...]]] = {
    "signed_distance_map mesh": (lambda x: sdm.signed_distance_map(x, 4), MESHES),
    "signed_distance_map grid": (lambda x: sdm.signed_distance_map(MESH, x), GRIDS),
    "signed_distance_map margin": (lambda x: sdm.signed_distance_map(MESH, 4, margin=x), LENGTHS),
    "signed_distance_map device": (lambda x: sdm.signed_distance_map(MESH, 4, device=x), DEVICES),
    "signed_distance_map sign": (lambda x: sdm.signed_distance_map(MESH, 4, sign=x), CHOICES),
    "signed_distance_map orient": (lambda x: sdm.signed_distance_map(MESH, 4, orient=x), CHOICES),
    "signed_distance_map hole_size": (lambda x: sdm.signed_distance_map(MESH, 4, sign="flood", hole_size=x), LENGTHS),
    "signed_distance mesh": (lambda x: sdm.signed_distance(x, POINTS), MESHES),
    "signed_distance points": (lambda x: sdm.signed_distance(MESH, x), POINT_SETS),
    "signed_distances meshes": (lambda x: sdm.signed_distances(x, [POINTS]), (None, 3, object(), "a", MESH, GRID)),
    "signed_distances points": (lambda x: sdm.signed_distances([MESH], x), POINT_SETS),
    "signed_distances max_bytes": (lambda x: sdm.signed_distances([MESH], [POINTS], max_bytes=x), NUMBERS),
    "signed_distance_maps max_bytes": (lambda x: sdm.signed_distance_maps([MESH], 4, max_bytes=x), NUMBERS),
    "narrow_band mesh": (lambda x: sdm.narrow_band(x, 0.2), NO_MESHES),
    "narrow_band spacing": (lambda x: sdm.narrow_band(MESH, spacing=x), (*LENGTHS, 0, ["a"] * 3)),
    "narrow_band half_width": (lambda x: sdm.narrow_band(MESH, 0.2, half_width=x), LENGTHS),
    "narrow_band margin": (lambda x: sdm.narrow_band(MESH, 0.2, margin=x), LENGTHS),
    "inspect_mesh": (sdm.inspect_mesh, MESHES),
    "orient_faces mesh": (sdm.orient_faces, MESHES),
    "orient_faces device": (lambda x: sdm.orient_faces(MESH, x), DEVICES),
    "MeshIndex device": (lambda x: sdm.MeshIndex(MESH, x), DEVICES),
    "watertight offset": (lambda x: sdm.watertight(MESH, 16, offset=x), LENGTHS),
    "euclidean_distance_transform spacing": (
        lambda x: sdm.euclidean_distance_transform(np.ones((2, 2, 2)), x),
        (*LENGTHS, 0, ["a"] * 3),
    ),
    "euclidean_distance_transform surface": (
        lambda x: sdm.euclidean_distance_transform(np.ones((2, 2, 2)), surface=x),
        CHOICES,
    ),
    "euclidean_distance_transform missing": (
        lambda x: sdm.euclidean_distance_transform(np.ones((2, 2, 2)), missing=x),
        (*OBJECTS, "nonsense", float("nan"), torch.zeros(2)),
    ),
    "euclidean_distance_transform classes": (
        lambda x: sdm.euclidean_distance_transform(np.ones((2, 2, 2)), classes=x),
        (*OBJECTS, "nonsense", MESH, [1.5]),
    ),
    "Grid.around margin": (lambda x: sdm.Grid.around(MESH, 4, margin=x), LENGTHS),
    "Grid.around_box": (lambda x: sdm.Grid.around_box(x, np.ones(3), 4), POINT_SETS),
    "Grid.from_affine": (lambda x: sdm.Grid.from_affine(x, (2, 2, 2)), (*POINT_SETS, POINTS)),
    "Grid.points": (GRID.points, (*NUMBERS, 6)),
    "TriangleMesh.to": (MESH.to, DEVICES),
    "SDM.to": (lambda x: field().to(x), (*OBJECTS[:-2], "nonsense", "cuda:99", MESH)),
    "SparseSDM.to": (lambda x: sdm.narrow_band(MESH, 0.2).to(x), DEVICES),
    "SDM.truncate": (lambda x: field().truncate(x), (*LENGTHS, 0)),
    "SDM.occupancy": (lambda x: field().occupancy(x), (*OBJECTS, "nonsense", None, float("nan"))),
    "SDM.to_mesh": (lambda x: field().to_mesh(x), (*OBJECTS, "nonsense", None, 10**400)),
    "SDM.sample": (lambda x: field().sample(POINTS, order=x), (*NUMBERS, 2)),
    "load": (sdm.load, PATHS),
    "load_mesh": (sdm.load_mesh, PATHS),
    "load_band": (sdm.io.load_band, PATHS),
    "mesh_files": (sdm.io.mesh_files, (*PATHS[:-3], "nonsense")),
    "mesh_tree": (sdm.io.mesh_tree, (*PATHS[:-3], "nonsense")),
    "save map": (lambda x: sdm.save(x, "never.npz"), (*OBJECTS, None, 3, "nonsense", MESH)),
    "save path": (lambda x: sdm.save(field(), x), PATHS),
    "save_mesh path": (lambda x: sdm.save_mesh(MESH, x), PATHS),
    "SDMDataset": (sdm.SDMDataset, PATHS),
}


def field() -> sdm.SDM:
    return sdm.SDM(np.ones(GRID.shape), GRID)


@pytest.mark.parametrize("name", CALLS)
def test_nonsense_is_refused_in_one_sentence(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, values = CALLS[name]
    found = {}
    for value in values:
        try:
            call(value)
            found[repr(value)] = "taken"
        except SDMError as error:
            if "\n" in str(error):
                found[repr(value)] = str(error)
        except Exception as error:  # noqa: BLE001
            found[repr(value)] = f"{type(error).__name__}: {error}"
    assert not found
    assert not list(tmp_path.iterdir())


def test_numbers_of_any_library_are_numbers():
    for three in (3, 3.0, np.int64(3), np.float32(3), torch.tensor(3), torch.tensor(3.0)):
        assert (real(three), whole(three, 3), whole(three, 4)) == (3, 3, None)
    assert whole(2**63, 0) is whole(3.5, 0) is whole("3", 0) is None
    assert np.isnan([real("3"), real(None), real(1j), real(10**400)]).all()
