"""Packages of the library are there as soon as `sdm` is, and imported when they are used, as is torch's compiler."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest

import sdm

# Libraries and kernels, which know of no package, take seconds to import: each question is asked of a copy of a
# process that has them.
PROGRAM = """
import json, os, sys
import sdm
assert "torch" not in sys.modules
import numpy as np
import scipy.interpolate, scipy.optimize, torch, warp
import sdm.kernels.band.query, sdm.kernels.closest.closest_voxels, sdm.kernels.points.query
import sdm.kernels.winding.cap_tree

def fails(work, *given):
    child = os.fork()
    if child == 0:
        work(*given)
        os._exit(0)
    return os.waitpid(child, 0)[1] != 0

def package(name):
    assert f"sdm.{name}" not in sys.modules
    getattr(sdm, name)
    assert name in dir(sdm)

def eager_calls():
    from sdm.bench.common.meshes import cube

    # Torch's own threads do not survive a fork.
    torch.set_num_threads(1)
    mesh = sdm.TriangleMesh(*cube())
    index = sdm.MeshIndex(mesh, "cpu")
    grid = sdm.Grid([0, 0, 0], [0.5] * 3, [4, 4, 4])
    sdm.signed_distance_map(mesh, grid, device="cpu")
    sdm.signed_distance_maps(mesh.vertices[None], mesh.faces, grid, device="cpu")
    index.signed_distance_map(grid)
    index.signed_distance(np.zeros((2, 3), np.float32), return_closest=True)
    index.winding_number(np.zeros((2, 3), np.float32))
    sdm.euclidean_distance_transform(torch.ones(3, 3, 3))
    sdm.shapes.Cochlea().vertices(torch.ones(1, 4))
    moving = torch.tensor(cube()[0], requires_grad=True)
    sdm.signed_distance(sdm.TriangleMesh(moving, mesh.faces), torch.zeros(1, 3), device="cpu").sum().backward()
    assert moving.grad is not None
    found = [name for name in ("torch._dynamo", "sympy") if name in sys.modules]
    assert not found, found

missing = [name for name in sdm._PACKAGES if fails(package, name)]
print(json.dumps({"missing": missing, "eager": fails(eager_calls)}))
"""


@pytest.fixture(scope="module")
def told() -> tuple[dict, str]:
    """Findings of the program, and the traces of what failed."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1]), done.stderr


def test_packages_are_attributes(told):
    found, traces = told
    assert not found["missing"], traces


def test_eager_calls_import_no_compiler(told):
    found, traces = told
    assert not found["eager"], traces


def test_packages_of_the_reference_are_attributes(root):
    """`import sdm` and a package's name are enough, whatever was imported before."""
    pages = (root / "docs" / "reference").glob("*.md")
    asked = re.compile(r"public-names:: sdm\.(\w+)$", re.MULTILINE)
    named = {name for page in pages for name in asked.findall(page.read_text())}
    # Adapters need the library that they are for.
    assert named - {"jax", "monai", "nnunet", "pyvista", "torchio"} <= sdm._PACKAGES.keys()
