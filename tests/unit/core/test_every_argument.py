"""Arguments of all public functions: none that is a mesh or a grid takes only a `TriangleMesh`, or only a `Grid`."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import nibabel as nib
import numpy as np
import pytest
import torch
import trimesh

import sdm
import sdm.deepsdf
import sdm.fit
import sdm.inspect
import sdm.io
import sdm.sampling
import sdm.shapes
from sdm.bench.common.meshes import cube

VERTICES, FACES = cube()
MESH = sdm.TriangleMesh(VERTICES, FACES)
POINTS = np.array([[0.0, 0, 0], [2, 0, 0]])
GRID = sdm.Grid([-2, -2, -2], [1, 1, 1], [5, 5, 5])
SCAN = nib.Nifti1Image(np.zeros(GRID.shape, np.float32), GRID.affine)
# Made by other calls, of their own parts: a grid is one of them.
MADE = {"SDM.later", "SDM.checked_by", "SparseSDM", "Closest", "Image"}
NARROW = {"TriangleMesh", "Grid", "TriangleMesh | None", "Grid | None", "Sequence[TriangleMesh]"}


def public() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Names that packages export, and the public methods of classes among them."""
    for part in pkgutil.iter_modules(sdm.__path__):
        if not part.ispkg or part.name in ("kernels", "bench", "cli", "jax", "nnunet", "explore"):
            continue
        package = importlib.import_module(f"sdm.{part.name}")
        for name in getattr(package, "__all__", ()):
            thing = getattr(package, name)
            if not callable(thing) or not str(getattr(thing, "__module__", "")).startswith("sdm"):
                continue
            yield name, thing
            if inspect.isclass(thing):
                for method, function in inspect.getmembers(thing, inspect.isroutine):
                    if not method.startswith("_"):
                        yield f"{name}.{method}", function


def test_no_public_argument_is_narrow():
    narrow, seen = [], 0
    for name, function in [*public(), *((n, getattr(sdm, n)) for n in sdm.__all__ if callable(getattr(sdm, n)))]:
        try:
            arguments = inspect.signature(function).parameters.values()
        except ValueError:
            continue
        for argument in arguments:
            kind = str(argument.annotation)
            seen += "MeshLike" in kind or "GridLike" in kind
            if kind in NARROW and name not in MADE:
                narrow.append(f"{name}({argument.name}: {kind})")
    assert seen > 20
    assert not narrow


def _saved(mesh: Any, folder: Path) -> np.ndarray:
    sdm.save_mesh(mesh, folder / "saved.ply")
    return sdm.load_mesh(folder / "saved.ply").vertices.numpy()


def _dual(mesh: Any, _: Path) -> np.ndarray:
    return sdm.signed_distance_map(MESH, 8, device="cpu").to_mesh(method="dual", mesh=mesh).vertices.numpy()


# Of a mesh and a folder: an answer of each function that `test_as_mesh` does not ask.
ANSWERS: dict[str, Callable[[Any, Path], Any]] = {
    "narrow_band": lambda mesh, _: sdm.narrow_band(mesh, 0.25, device="cpu").values.numpy(),
    "orient_faces": lambda mesh, _: sdm.orient_faces(mesh, "cpu").faces.numpy(),
    "signed_distances": lambda mesh, _: sdm.signed_distances([mesh], [POINTS], device="cpu")[0].numpy(),
    "watertight": lambda mesh, _: sdm.watertight(mesh, resolution=16, device="cpu").vertices.numpy(),
    "save_mesh": _saved,
    "to_mesh": _dual,
    "orient_outward": lambda mesh, _: sdm.inspect.orient_outward(mesh).faces.numpy(),
    "sample": lambda mesh, _: sdm.sampling.sample(mesh, 50, name="a", device="cpu").points,
    "surface_points": lambda mesh, _: sdm.sampling.surface_points(mesh, 20)[0].numpy(),
    "MeshFolder": lambda mesh, _: sdm.shapes.MeshFolder([mesh]).meshes[0].vertices.numpy(),
}
KINDS = {
    "pair": (VERTICES, FACES),
    "lists": (VERTICES.tolist(), FACES.tolist()),
    "trimesh": trimesh.Trimesh(VERTICES, FACES, process=False),
}


@pytest.mark.parametrize("name", ANSWERS)
def test_meshes_of_every_kind(name, tmp_path):
    MESH.save(tmp_path / "cube.ply")
    wanted = np.asarray(ANSWERS[name](MESH, tmp_path))
    for mesh in (*KINDS.values(), tmp_path / "cube.ply", str(tmp_path / "cube.ply")):
        np.testing.assert_array_equal(np.asarray(ANSWERS[name](mesh, tmp_path)), wanted)
    with pytest.raises(sdm.MeshError, match="int is no mesh: give a TriangleMesh, the path"):
        ANSWERS[name](3, tmp_path)


def test_grids_of_every_kind(tmp_path):
    nib.save(SCAN, tmp_path / "scan.nii")
    values = torch.zeros(GRID.shape)
    for grid in (GRID, SCAN, sdm.SDM(values, GRID), tmp_path / "scan.nii", str(tmp_path / "scan.nii")):
        assert sdm.SDM(values, grid).grid == GRID
        sdm.io.write_streamed(sdm.MeshIndex(MESH, "cpu"), grid, tmp_path / "map.npz")
        assert sdm.load(tmp_path / "map.npz").grid == GRID
        assert sdm.fit.GridBackend(lambda theta: values, grid).grid == GRID
    sdm.io.write_streamed(sdm.MeshIndex(MESH, "cpu"), 6, tmp_path / "map.npz")
    assert sdm.load(tmp_path / "map.npz").grid == sdm.Grid.around(MESH, 6)
    with pytest.raises(sdm.GridError, match="Tensor is no grid: give a Grid, a number of voxels"):
        sdm.SDM(values, values)
    with pytest.raises(sdm.GridError, match="says nothing without a mesh"):
        sdm.SDM(values, 5)
