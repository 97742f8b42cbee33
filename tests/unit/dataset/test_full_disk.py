"""A disk that is really full: one sentence, one shard lost, and the same bytes once there is room."""

from __future__ import annotations

import filecmp
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.helpers import generate_command

# In namespaces of its own any user may mount a small disk, which goes with the last process.
PRIVATE = ["unshare", "--user", "--map-root-user", "--mount"]
SCENE = """
set -e
mount -t tmpfs -o size=3m tmpfs disk
if "$@" -o disk/d.zarr 2> said; then exit 99; else echo $? > code; fi
ls -a disk/d.zarr.part > left
ls disk/d.zarr.part/sha256/c | wc -l > shards
mount -o remount,size=64m disk
"$@" --resume -o disk/d.zarr
cp -r disk/d.zarr kept.zarr
"""


@pytest.mark.slow
@pytest.mark.parametrize("way", generate_command.WAYS)
def test_a_full_disk(tmp_path, way):
    if shutil.which("unshare") is None or subprocess.call([*PRIVATE, "true"], stderr=subprocess.DEVNULL):
        pytest.skip("this system does not let its users mount a disk of their own")
    (tmp_path / "disk").mkdir()
    options = ["--count", "40", "--resolution", "32", "--triangles", "600", "--shard", "2", "--device", "cpu"]
    command = [*generate_command.words(way), "cochlea", *options]
    run = subprocess.run(
        [*PRIVATE, "sh", "-c", SCENE, "sh", *command],
        check=False,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "code").read_text() == "2\n"
    said = (tmp_path / "said").read_text()
    assert "No space left on device; --resume goes on from there" in said
    assert said.count("\n") == 1
    assert ".part" not in (tmp_path / "left").read_text()
    assert 0 < int((tmp_path / "shards").read_text()) < 20
    subprocess.run([*command, "-o", tmp_path / "whole.zarr"], check=True, capture_output=True)
    assert files(tmp_path / "kept.zarr") == files(tmp_path / "whole.zarr")
    same, different, wrong = filecmp.cmpfiles(
        tmp_path / "kept.zarr", tmp_path / "whole.zarr", files(tmp_path / "whole.zarr"), shallow=False
    )
    assert not different
    assert not wrong
    assert len(same) > 40


def files(folder: Path) -> list[str]:
    return sorted(str(f.relative_to(folder)) for f in folder.rglob("*") if f.is_file())
