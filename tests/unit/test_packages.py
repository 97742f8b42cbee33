"""Packages of the library are there as soon as `sdm` is, and imported when they are used."""

from __future__ import annotations

import subprocess
import sys

import pytest

import sdm


@pytest.mark.parametrize("name", sdm._PACKAGES)
def test_packages_are_attributes(name):
    program = f"import sdm, sys; assert 'torch' not in sys.modules; sdm.{name}; assert '{name}' in dir(sdm)"
    subprocess.run([sys.executable, "-c", program], check=True)
