"""Commands import what they need and nothing else: `python -m sdm.bench.cli.startup` measures what that takes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from sdm.core.demo_mesh import demo_mesh
from sdm.io.meshes.write import write_ply

HEAVY = ("torch._dynamo", "trimesh", "networkx", "skimage", "matplotlib", "nibabel", "nrrd", "zarr", "rich.progress")
# Kernels that a plain map has no use for.
UNUSED = ("sdm.kernels.flood.flood_signs", "sdm.kernels.closest.closest_voxels", "sdm.kernels.bvh.ray_hits")
PROGRAM = """
import sys
from sdm.cli import main
assert main({words!r}) == 0
print("imported:", *(name for name in {heavy!r} if name in sys.modules))
"""


@pytest.mark.parametrize(
    ("words", "others"),
    [
        (["--help"], ("torch", "warp", "scipy")),
        (["inspect", "mesh.ply"], ("warp",)),
        (["compute", "mesh.ply", "-o", "map.npz", "--resolution", "16", "--device", "cpu"], ("scipy.sparse", *UNUSED)),
    ],
    ids=["help", "inspect", "compute"],
)
def test_nothing_is_imported_in_vain(words, others, tmp_path):
    write_ply(demo_mesh(rings=21, segments=8, cap_rings=2), tmp_path / "mesh.ply")
    code = PROGRAM.format(words=words, heavy=(*HEAVY, *others))
    out = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert out.stdout.splitlines()[-1] == "imported:", out.stdout.splitlines()[-1]


@pytest.mark.parametrize(("given", "frozen"), [("", "True"), ('["--version"]', "False")])
def test_no_look_for_garbage_at_the_end(given, frozen):
    """Of a process that is a command, and of no other."""
    code = f"import gc; from sdm.cli import main; main({given}); print(gc.get_freeze_count() > 0)"
    command = [sys.executable, "-c", code, "--version"]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[-1] == frozen
