"""OpenVDB reads the .nvdb files of narrow bands as the level sets that they are."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import sdm
from sdm.bench.common.meshes import sphere

SOURCE = Path(__file__).with_name("read_by_openvdb.cpp")
# Debian's libnanovdb-dev, or a folder that has its headers.
HEADERS = Path(os.environ.get("NANOVDB_INCLUDE", "/usr/include"))


def test_the_program_of_the_page_has_the_band_s_own_distances(tmp_path, monkeypatch):
    if shutil.which("g++") is None or not (HEADERS / "nanovdb/util/SampleFromVoxels.h").is_file():
        pytest.skip("needs g++ and libnanovdb-dev")
    page = (Path(__file__).parents[4] / "docs/from/openvdb.md").read_text(encoding="utf-8")
    (tmp_path / "distance.cpp").write_text(page.partition("```cpp\n")[2].partition("```")[0], encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    words = ["g++", "-O2", "-std=c++17", f"-I{HEADERS}", "distance.cpp", "-o", "distance", "-lz"]
    subprocess.run(words, capture_output=True, check=True)
    band = sdm.narrow_band(sdm.TriangleMesh(*sphere(12)), resolution=32, half_width=4.0, device="cpu")
    band.save("band.nvdb")
    for place in ((0.9, 0.1, 0.2), (0.0, -0.95, 0.3), (1.0, 0.0, 0.05)):
        told = subprocess.run(["./distance", *map(str, place)], capture_output=True, text=True, check=True)
        assert float(told.stdout) == pytest.approx(float(band.sample([place])[0]), abs=2e-6)


@pytest.mark.slow
def test_openvdb_reads_a_band(tmp_path):
    if shutil.which("g++") is None or not (HEADERS / "nanovdb/util/NanoToOpenVDB.h").is_file():
        pytest.skip("needs g++, libopenvdb-dev and libnanovdb-dev")
    program = tmp_path / "read"
    words = ["g++", "-O0", "-std=c++17", "-DNANOVDB_USE_ZIP", f"-I{HEADERS}", str(SOURCE), "-o", str(program)]
    built = subprocess.run(
        [*words, "-lopenvdb", "-ltbb", "-lImath-3_1", "-lz"], capture_output=True, text=True, check=False
    )
    if built.returncode:
        pytest.skip(f"OpenVDB's program does not compile here: {built.stderr.strip().splitlines()[0]}")
    grid = sdm.Grid((-1.3,) * 3, (0.05,) * 3, (53,) * 3)
    band = sdm.narrow_band(sdm.TriangleMesh(*sphere(12)), grid, device="cpu")
    band.save(tmp_path / "band.nvdb")
    voxels = np.random.default_rng(0).integers(0, 53, (2000, 3))
    asked = "\n".join(" ".join(map(str, voxel)) for voxel in voxels.tolist())
    told = subprocess.run([program, tmp_path / "band.nvdb"], input=asked, capture_output=True, text=True, check=True)
    first, *values = told.stdout.splitlines()
    active, leaves, background, level_set = first.split()
    assert (int(active), int(leaves), int(level_set)) == (band.active_voxels, len(band), 1)
    assert np.float32(background) == np.float32(band.width)
    expected = band.to_dense().values.numpy()[tuple(voxels.T)]
    assert (expected < 0).any()
    np.testing.assert_array_equal(np.array(values, np.float32), expected)
