"""A Ray cluster shares the shards: one that loses a node makes the identical dataset, one that cannot work says why."""

from __future__ import annotations

import faulthandler
import hashlib
import os
import signal
import socket
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
import trimesh

from sdm.cli import main
from sdm.cli.common.termination import Terminated, raised_termination
from sdm.cli.maps import run as map_run
from sdm.cli.maps import sample_run
from sdm.cli.maps.map_job import MapJob
from sdm.cli.maps.sample_job import SampleJob
from sdm.cli.surfaces import closing
from sdm.cli.surfaces.closing_job import ClosingJob
from sdm.dataset import SDMDataset, generate
from sdm.dataset.shard_job import Job
from sdm.errors import SDMError
from sdm.runtime.sharing import ray_cluster as cluster
from sdm.shapes import Cochlea, Family
from sdm.stream import Uniform

FAMILY = Cochlea(5_000)
COUNT = 60


def contents(folder: Path) -> dict[str, str]:
    files = (f for f in folder.rglob("*") if f.is_file() and f.name != "zarr.json")
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def write(path, **options):
    return generate(FAMILY, FAMILY.grid(64), COUNT, path, shard=1, **options)


def test_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SDMError, match=r"pip install '\.\[ray\]'"):
        write(tmp_path / "d.zarr", ray="auto")


@pytest.mark.parametrize("address", ["127.0.0.1:{}", "ray://127.0.0.1:{}", "[::1]:{}", "127.0.0.1:6553600"])
def test_an_address_where_nothing_answers(address, tmp_path, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as server:
        free = server.getsockname()[1]
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(is_initialized=lambda: False))
    with pytest.raises(SDMError, match="there is no Ray cluster at"):
        cluster.run_on_ray(job(FAMILY, tmp_path), [0], address.format(free), lambda _: None)


def job(family: Family, folder: Path) -> Job:
    (folder / "zarr.json").write_text("{}")
    manifest = {"device": "cpu", "count": 2, "shard": 1}
    return Job(folder, manifest, family, FAMILY.grid(8), Uniform(), 0, torch.float32, None)


def not_there() -> Family:
    raise ModuleNotFoundError("No module named 'theirs'")


class Unknown(Cochlea):
    """As a family that no other machine has."""

    def __reduce__(self) -> Any:
        return not_there, ()


def ends_at(call: int) -> Family:
    """A family that takes its process with it at one of the calls of `vertices`."""
    family, left = Cochlea(600), [call]

    def vertices(theta: torch.Tensor) -> torch.Tensor:
        left[0] -= 1
        if not left[0]:
            os._exit(1)
        return Cochlea.vertices(family, theta)

    family.vertices = vertices
    return family


def test_workers_find_a_dataset_that_was_named_from_here(tmp_path, monkeypatch):
    told = []

    class Crew:
        def __init__(self, ray: Any, job: Job, done: Any) -> None:
            told.append(job.folder)

        def run(self, todo: list[int]) -> None:
            assert todo == [1, 0]

    monkeypatch.setattr(cluster, "_Crew", Crew)
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(is_initialized=lambda: True))
    monkeypatch.chdir(tmp_path)
    Path("d.zarr.part").mkdir()
    cluster.run_on_ray(job(FAMILY, Path("d.zarr.part")), [0, 1], "auto", lambda _: None)
    assert told == [Path.cwd() / "d.zarr.part"]


@pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")
def test_termination_is_handled_as_before(tmp_path, monkeypatch):
    """Ray puts a handler in the place of Python's, and one below it, as faulthandler does here."""

    class Crew:
        def __init__(self, ray: Any, job: Job, done: Any) -> None:
            pass

        def run(self, todo: list[int]) -> None:
            os.kill(os.getpid(), signal.SIGTERM)

    with (tmp_path / "dump").open("w") as dump:

        def init(**_: Any) -> None:
            signal.signal(signal.SIGTERM, lambda number, _: sys.exit(number))
            faulthandler.register(signal.SIGTERM, file=dump)

        ray = SimpleNamespace(
            is_initialized=lambda: False,
            init=init,
            shutdown=lambda: faulthandler.unregister(signal.SIGTERM),
        )
        monkeypatch.setattr(cluster, "_Crew", Crew)
        monkeypatch.setitem(sys.modules, "ray", ray)
        with pytest.raises(Terminated), raised_termination():
            cluster.run_on_ray(job(FAMILY, tmp_path), [0], "auto", lambda _: None)
    assert not (tmp_path / "dump").read_text()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_workers_that_cannot_work_are_given_up(tmp_path, monkeypatch):
    ray = pytest.importorskip("ray", reason="needs Ray, an extra")
    monkeypatch.setattr(cluster, "LOOK", 0.1)
    ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    try:
        for family, message in (
            (Unknown(600), r"cannot start: .*No module named 'theirs'"),
            (ends_at(1), r"loses its workers again and again, the last one to this"),
            (ends_at(2), r"shard 0 has lost 3 workers, .* \.\.\.; --resume"),
        ):
            with pytest.raises(SDMError, match=message):
                cluster.run_on_ray(job(family, tmp_path), [0, 1], "auto", lambda _: None)
        elsewhere = job(FAMILY, tmp_path)
        (tmp_path / "zarr.json").unlink()
        with pytest.raises(SDMError, match=r"does not see .*: write to a disk"):
            cluster.run_on_ray(elsewhere, [0, 1], "auto", lambda _: None)
    finally:
        ray.shutdown()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_lost_node_changes_nothing(tmp_path):
    ray = pytest.importorskip("ray", reason="needs Ray, an extra")
    cluster_utils = pytest.importorskip("ray.cluster_utils")
    # The head has no CPU for workers, so that the node that is lost is one of those at work.
    cluster = cluster_utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    cluster.wait_for_nodes()
    lost = threading.Event()

    def lose_one() -> None:
        # Each worker has a folder of its own while it makes a shard: one goes when both are in the middle of one.
        while not (tmp_path / "d.zarr").exists():
            if len(list(tmp_path.glob("d.zarr.part/.*.part"))) == 2:
                cluster.remove_node(nodes[1], allow_graceful=False)
                lost.set()
                return
            time.sleep(0.01)

    def slowly(done: int, total: int) -> None:
        # The first worker must not be through before the second has started.
        time.sleep(0 if lost.is_set() else 0.3)

    watch = threading.Thread(target=lose_one, daemon=True)
    watch.start()
    try:
        write(tmp_path / "d.zarr", ray=cluster.address, progress=slowly)
    finally:
        ray.shutdown()
        cluster.shutdown()
    watch.join()
    assert lost.is_set()
    alone = write(tmp_path / "alone.zarr", device="cpu")
    assert contents(tmp_path / "d.zarr") == contents(alone)
    assert SDMDataset(tmp_path / "d.zarr").manifest["device"] == "cpu"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_folders_by_a_cluster_that_loses_a_worker(tmp_path, monkeypatch):
    """`sdm compute`, `sample` and `watertight`: a worker that is killed costs one shard, and changes no byte."""
    ray = pytest.importorskip("ray", reason="needs Ray, an extra")
    monkeypatch.setattr(cluster, "LOOK", 0.1)
    (tmp_path / "in").mkdir()
    for number in range(24):
        trimesh.creation.icosphere(1, radius=1 + number).export(tmp_path / "in" / f"{number:02}.ply")
    log = tmp_path / "log"

    def dying(job: type) -> type:
        """A job that kills its process in the middle of its second shard, the first time."""

        class Dies(job):
            def run(self, shards, maker, done, **more):
                for shard in shards:
                    with log.open("a") as file:
                        file.write(f"{job.__name__} {shard}\n")
                    if log.read_text().count(job.__name__) == 2:
                        self.run_some(shard, maker)
                    super().run([shard], maker, done, **more)

            def run_some(self, shard, maker):
                # A shard of half of the items, which are then there.
                half = replace(self, wanted=self.numbers(shard)[:2])
                job.run(half, [0], maker, lambda _: os.kill(os.getpid(), signal.SIGKILL))

        return Dies

    monkeypatch.setattr(map_run, "MapJob", dying(MapJob))
    monkeypatch.setattr(sample_run, "SampleJob", dying(SampleJob))
    monkeypatch.setattr(closing, "ClosingJob", dying(ClosingJob))
    ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    more = {"compute": ["--format", "npz", "--resolution", "8"], "sample": ["--count", "100", "--dataset", "d"]}
    more["watertight"] = ["--resolution", "12"]
    try:
        for command, options in more.items():
            words = [command, str(tmp_path / "in"), "--device", "cpu", *options, "-o"]
            assert main([*words, str(tmp_path / f"{command}-ray"), "--ray", "auto"]) == 0
            assert main([*words, str(tmp_path / f"{command}-here")]) == 0
            found, expected = (contents(tmp_path / f"{command}-{where}") for where in ("ray", "here"))
            found.pop("report.json", None), expected.pop("report.json", None)
            assert found == expected
            assert len(found) >= 24
    finally:
        ray.shutdown()
    made = log.read_text().split("\n")
    for job, shards in (("MapJob", 3), ("SampleJob", 3), ("ClosingJob", 6)):
        # One of them twice.
        assert sorted(line for line in made if job in line) == sorted(
            [f"{job} 1", *(f"{job} {n}" for n in range(shards))]
        )
