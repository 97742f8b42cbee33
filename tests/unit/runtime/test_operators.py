"""Operators load no compiler unless one is used."""

from __future__ import annotations

import subprocess
import sys

PLAIN = """
import sys, numpy as np, torch, sdm
from sdm.bench.common.meshes import cube
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
print([name for name in ("torch._dynamo", "sympy") if name in sys.modules])
"""


def test_eager_calls_import_no_compiler():
    done = subprocess.run([sys.executable, "-c", PLAIN], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
