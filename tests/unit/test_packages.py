"""Packages of the library are there as soon as `sdm` is, and imported when they are used."""

from __future__ import annotations

import re
import subprocess
import sys

import sdm

# Libraries and kernels, which know of no package, take seconds to import: each package is asked for by a copy of a
# process that has them.
PROGRAM = """
import os, sys
import sdm
assert "torch" not in sys.modules
import scipy.interpolate, scipy.optimize, torch, warp
import sdm.kernels.band.query, sdm.kernels.closest.closest_voxels, sdm.kernels.points.query
import sdm.kernels.winding.cap_tree
missing = []
for name in sdm._PACKAGES:
    child = os.fork()
    if child == 0:
        assert f"sdm.{name}" not in sys.modules
        getattr(sdm, name)
        assert name in dir(sdm)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        missing.append(name)
assert not missing, missing
"""


def test_packages_are_attributes():
    subprocess.run([sys.executable, "-c", PROGRAM], check=True)


def test_packages_of_the_reference_are_attributes(root):
    """`import sdm` and a package's name are enough, whatever was imported before."""
    pages = (root / "docs" / "reference").glob("*.md")
    asked = re.compile(r"public-names:: sdm\.(\w+)$", re.MULTILINE)
    named = {name for page in pages for name in asked.findall(page.read_text())}
    # Adapters need the library that they are for.
    assert named - {"jax", "monai", "nnunet", "pyvista", "torchio"} <= sdm._PACKAGES.keys()
