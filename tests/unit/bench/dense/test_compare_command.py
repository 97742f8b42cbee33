"""`sdm bench` compares what is installed, and refuses bad numbers."""

from __future__ import annotations

import pytest

from sdm import SDMError
from sdm.cli.commands import bench as command


def test_runs(tmp_path, capsys):
    out = tmp_path / "results.json"
    code = command.bench(meshes=("cube",), resolutions=(8,), peers=("sdm",), device="cpu", quick=True, out=out)
    assert code == 0
    assert "cube at 8^3 (12 triangles)" in capsys.readouterr().out
    assert out.is_file()


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        ({"runs": 0}, "runs"),
        ({"points": -1}, "points"),
        ({"resolutions": (0,)}, "resolution"),
        ({"budget_s": 0.0}, "budget"),
    ],
)
def test_bad_numbers_are_refused(choice, said):
    with pytest.raises(SDMError, match=said):
        command.bench(meshes=("cube",), peers=("sdm",), device="cpu", **choice)


def test_a_file_that_is_no_mesh_is_named(tmp_path):
    path = tmp_path / "cut.ply"
    path.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nend_header\n")
    with pytest.raises(SDMError, match=r"cut\.ply cannot be read .*: sdm inspect says more"):
        command.bench(meshes=(str(path),), resolutions=(8,), peers=("sdm",), device="cpu", quick=True)
