"""`sdm compute` by several devices: the same bytes and lines as by one, and a restart that goes by the manifest."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import trimesh

from sdm.cli import main
from sdm.cli.maps.line_file import NAME
from sdm.cli.maps.map_job import MapJob
from sdm.cli.maps.map_manifest import MapManifest
from sdm.cli.maps.map_stages import MapStages
from sdm.cli.maps.map_told import tasks_of
from sdm.cli.maps.run import processes_of, run
from sdm.errors import SDMError
from sdm.runtime.sharing import process_count
from sdm.runtime.sharing.share_out import shard_size
from tests.helpers.map_settings import map_settings

COUNT = 20


@pytest.fixture
def folder(tmp_path):
    """Meshes that differ, one of them bad, one open."""
    place = tmp_path / "in"
    place.mkdir()
    for number in range(COUNT):
        ball = trimesh.creation.icosphere(1)
        ball.apply_scale([1, 1 + 0.1 * number, 1])
        if number == 7:
            ball = trimesh.Trimesh(ball.vertices, ball.faces[:-9], process=False)
        ball.export(place / f"{number:02}.ply")
    (place / "03.ply").write_bytes(b"ply\n")
    return place


def jobs_of(folder: Path, out: Path) -> list[tuple[Path, Path]]:
    out.mkdir()
    return [(file, out / f"{file.stem}.npz") for file in sorted(folder.iterdir())]


def contents(out: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in out.iterdir()}


def test_two_processes_make_what_one_makes(folder, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr("sdm.cli.maps.map_sharing.processes_for", lambda devices, *_, **__: devices)
    lines, found, reports = [], [], []
    for name, devices in (("one", ["cpu"]), ("two", ["cpu", "cpu"])):
        out = tmp_path / name
        report = tmp_path / f"{name}.json"
        assert run(jobs_of(folder, out), map_settings(10), devices=devices, folder=out, report=report) == 2
        said = capfd.readouterr()
        lines.append([line.partition(" voxels")[0] for line in (said.out + said.err).splitlines()])
        found.append(contents(out))
        reports.append([{**entry, "seconds": 0, "output": 0} for entry in json.loads(report.read_text())["meshes"]])
    assert found[0] == found[1]
    assert len(found[0]) == COUNT - 1
    assert lines[0] == lines[1]
    assert reports[0] == reports[1]
    assert [entry["state"] for entry in reports[0]].index("failed") == 3
    # Clocks of all processes.
    for name in ("one", "two"):
        busy = json.loads((tmp_path / f"{name}.json").read_text())["seconds_of_stages"]
        assert list(busy) == ["read", "cpu", "write"]
        assert min(busy.values()) > 0


# Each process says when it works, slowly, so that none comes to the end before it is killed. If two are wanted, the
# first one waits for the other.
SEVERAL = """
import os
import sys
import time
from pathlib import Path

from sdm.cli import main
from sdm.cli.maps import map_sharing, run
from sdm.cli.maps.map_stages import MapStages
from sdm.runtime.sharing import devices

map_sharing.processes_for, devices.devices_for = lambda devices, *_, **__: devices, lambda _: ["cpu", "cpu"]
# The second one is started before torch is imported.
map_sharing.gpus_expected = devices.devices_for
run.shard_size = lambda *_: 1
measure, seen, wanted = MapStages.measure, Path(os.environ["SEEN"]), int(os.environ["WANTED"])


def slowly(stages, group):
    Path(seen, str(os.getpid())).touch()
    while len(list(seen.iterdir())) < wanted:
        time.sleep(0.01)
    time.sleep(0.3)
    return measure(stages, group)


MapStages.measure = slowly
if __name__ == "__main__":
    sys.exit(main())
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes as Linux has them")
def test_what_is_cut_off_leaves_no_process_and_is_made_good_by_a_restart(folder, tmp_path, capsys):
    """A process that is lost is named; those of a command that is killed end, and do not go on writing."""
    out, words = tmp_path / "out", ["compute", str(folder), "--format", "npz", "--resolution", "16", "-o"]
    script = tmp_path / "several.py"
    script.write_text(SEVERAL)
    for number in range(COUNT, 4 * COUNT):
        shutil.copy(folder / "00.ply", folder / f"{number}.ply")
    # While the second process starts, and while both work.
    for number, (wanted, victim) in enumerate(product((1, 2), ("interrupt", "child", "parent"))):
        before, seen = len(list(out.glob("[0-9]*.npz"))), tmp_path / f"seen {number}"
        seen.mkdir()
        command = [sys.executable, "-W", "ignore", str(script), *words, str(out), "--resume"]
        pipes: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
        around = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[4]), "SEEN": str(seen), "WANTED": str(wanted)}
        child = subprocess.Popen(command, start_new_session=True, env=around, **pipes)
        _wait_for(lambda before=before: len(list(out.glob("[0-9]*.npz"))) > before)
        processes = _workers(child.pid)
        assert len(processes) == 1
        if victim == "interrupt":
            # As a terminal does it, to all of them.
            os.killpg(child.pid, signal.SIGINT)
        else:
            os.kill(processes[0] if victim == "child" else child.pid, signal.SIGKILL)
        said = child.communicate(timeout=90)[1]
        if victim == "child":
            assert "the process on cpu died (exit code -9); --resume goes on from there" in said
        assert "Traceback" not in said
        assert child.returncode == {"interrupt": 130, "child": 2, "parent": -9}[victim], said
        _wait_for(lambda session=child.pid: not _running(session))
        assert len(list(out.glob("[0-9]*.npz"))) < 4 * COUNT - 1
    assert main([*words, str(out), "--resume"]) == 2
    assert main([*words, str(tmp_path / "whole")]) == 2
    found = {name: content for name, content in contents(out).items() if not name.startswith(".")}
    assert found == contents(tmp_path / "whole")


def _wait_for(ask: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + 90
    while not (found := ask()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return found


def _workers(pid: int) -> list[int]:
    """Processes that work for another: its children but for the one that keeps track of semaphores."""
    found = map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())
    return [one for one in found if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes()]


def _running(session: int) -> list[int]:
    """All processes that a command has begun and that have not ended, by the number of its session."""
    found = []
    for place in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, _, own = place.read_text().rpartition(")")[2].split()[:4]
            if int(own) == session and state != "Z":
                found.append(int(place.parent.name))
    return found


def test_a_restart_reads_no_mesh_that_the_manifest_has(folder, tmp_path, monkeypatch, capsys):
    out, words = tmp_path / "out", ["compute", str(folder), "--format", "npz", "--resolution", "10", "--skip-bad"]
    read, seen = MapStages.read, []

    def noted(self, task):
        seen.append(task.name)
        if len(seen) == 12:
            raise KeyboardInterrupt
        return read(self, task)

    monkeypatch.setattr(MapStages, "read", noted)
    assert main([*words, "-o", str(out)]) == 130
    known = [json.loads(line) for line in (out / NAME).read_text().splitlines() if line]
    assert known
    done = [Path(line["target"]).stem for line in known]
    # A torn line, and a mesh and a map that were touched since.
    with (out / NAME).open("a") as file:
        file.write('{"settings": "')
    os.utime(folder / f"{done[0]}.ply")
    (out / f"{done[1]}.npz").write_bytes(b"no map")
    seen.clear()
    monkeypatch.setattr(MapStages, "read", lambda self, task: (seen.append(task.name), read(self, task))[1])
    capsys.readouterr()
    assert main([*words, "-o", str(out), "--resume"]) == 0
    assert {f"{name}.ply" for name in done[2:]}.isdisjoint(seen)
    assert {f"{name}.ply" for name in done[:2]} <= set(seen)
    assert len(seen) == COUNT - len(done) + 2
    assert not (out / NAME).exists()
    # The report tells of those as of the others.
    entries = json.loads((out / "report.json").read_text())["meshes"]
    assert [Path(entry["mesh"]).name for entry in entries] == sorted(file.name for file in folder.iterdir())
    assert all(entry["triangles"] > 0 for entry in entries if entry["state"] != "failed")
    assert main([*words, "-o", str(tmp_path / "whole")]) == 0
    whole = contents(tmp_path / "whole")
    assert {name: kept for name, kept in contents(out).items() if name != "report.json"} == {
        name: kept for name, kept in whole.items() if name != "report.json"
    }


def test_the_manifest_is_of_its_settings(folder, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    words = ["compute", str(folder), "-o", str(out), "--format", "npz", "--skip-bad", "--device", "cpu"]

    def run_and_keep(resolution: int) -> int:
        with monkeypatch.context() as patch:
            patch.setattr(Path, "unlink", lambda self, missing_ok=False: None)
            assert main([*words, "--resolution", str(resolution), "--resume"]) == 0
        assert (out / NAME).exists()
        return capsys.readouterr().out.count("is there already")

    assert [run_and_keep(resolution) for resolution in (8, 9, 9)] == [0, 0, COUNT - 1]


def test_a_manifest_that_another_command_took_away(tmp_path, monkeypatch):
    """As of two that write to one folder, and end together."""
    manifest, exists = MapManifest(tmp_path, map_settings(8), resume=True), Path.exists
    monkeypatch.setattr(Path, "exists", lambda self, **how: self.name == NAME or exists(self, **how))
    with manifest:
        pass
    assert not list(tmp_path.iterdir())


def test_what_a_machine_of_a_cluster_does_not_see(folder, tmp_path):
    job = MapJob(wanted=[0, 1], each=8, tasks=tasks_of(jobs_of(folder, tmp_path / "out")), settings=map_settings(8))
    job.check()
    (tmp_path / "out").rmdir()
    with pytest.raises(SDMError, match=r"does not see .*out: write to a disk that all of them share"):
        job.check()
    job.agree("H100")
    with pytest.raises(SDMError, match="both H100 and T4"):
        job.agree("T4")


def test_who_shares_the_work(monkeypatch):
    monkeypatch.setattr(process_count, "cores", lambda: 32)
    two = ["cuda:0", "cuda:1"]
    # One has ended when others would have started.
    assert processes_of(1200, map_settings(128), two) == ["cuda:0"]
    assert processes_of(5000, map_settings(128), two) == two * 4
    # Large maps are few: a process of each device makes them.
    assert processes_of(1000, map_settings(512), two) == two
    assert processes_of(100_000, map_settings(128), ["cpu"]) == ["cpu"]
    assert processes_of(100_000, map_settings(128), None) == ["cpu"]
    four = [f"cuda:{n}" for n in range(4)]
    assert processes_of(20_000, map_settings(128), four) == four * 2
    monkeypatch.setattr(process_count, "cores", lambda: 2)
    assert processes_of(100_000, map_settings(128), two) == two


def test_sizes_of_shards():
    assert shard_size(20, 2) == 8
    assert shard_size(1000, 2) == 8
    assert shard_size(2400, 4) == 16
    assert shard_size(10_000_000, 8) == 64
    assert shard_size(1000, 0) == 8
