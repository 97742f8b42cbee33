"""`sdm doctor`: the table, JSON, what it calls a problem, and kernels compiled ahead."""

from __future__ import annotations

import copy
import json
import tomllib

import pytest

from sdm.cli import main
from sdm.cli.machine import extras
from sdm.cli.machine.facts import cache_facts, facts, problems


@pytest.fixture(scope="module")
def found():
    return facts()


def test_the_table(capsys):
    assert main(["doctor"]) == 0
    said = capsys.readouterr()
    for words in ("torch", "warp", "threads for kernels", "compiled kernels", "[formats]"):
        assert words in said.out
    assert said.err == ""


def test_kernels_are_compiled_ahead(capsys):
    assert main(["doctor", "--compile", "--device", "cpu", "--json"]) == 0
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert told["compiled"]["cpu"] > 0
    assert [line.split(":")[1].split(",")[0].strip() for line in said.err.splitlines()] == ["cpu"] * 8
    assert told["cache"]["for_cpu"] > 0


def test_a_device_that_is_not_there(capsys):
    assert main(["doctor", "--device", "cuda:99"]) == 2
    assert capsys.readouterr().err.startswith("sdm: the device cuda:99 was requested")


def test_every_extra_is_for_users_or_development(root):
    told = tomllib.loads((root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert set(told) == extras.USES.keys() | extras.DEVELOPMENT


def test_what_is_missing_of_an_extra(monkeypatch):
    lines = ["numpy>=2", 'tyro>=1; extra == "ray"', "no-such-package>=2; extra == 'ray'"]
    monkeypatch.setattr(extras.metadata, "requires", lambda _: lines)
    assert [(extra.name, extra.missing) for extra in extras.extras()] == [("ray", ["no-such-package"])]


def test_cache(tmp_path):
    for name in (
        "wp_sdm.kernels.a_1/wp_sdm.kernels.a_1.cpu.o",
        "wp_sdm.kernels.a_1/wp_sdm.kernels.a_1.sm90.cubin",
        "b/b.o",
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"123")
    told = cache_facts(tmp_path)
    assert (told["for_cpu"], told["for_gpu"], told["bytes"]) == (1, 1, 9)
    assert cache_facts(tmp_path / "not" / "yet")["bytes"] == 0


def test_files_that_another_process_takes_away_are_left_out(tmp_path, monkeypatch):
    (tmp_path / "there.o").write_bytes(b"123")
    monkeypatch.setattr("os.walk", lambda folder: [(str(folder), [], ["gone.o", "there.o"])])
    assert cache_facts(tmp_path)["bytes"] == 3


def test_nothing_is_in_the_way_here(found):
    assert found["problems"] == problems(found)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"cuda": {"driver_file": True, "of_torch": None}, "gpus": []}, "torch is a build without CUDA"),
        ({"cuda": {"driver_file": True, "of_torch": "13.0"}, "gpus": []}, "CUDA_VISIBLE_DEVICES"),
        ({"cuda": {"seen_by_warp": 0}, "gpus": [{}]}, "update the driver"),
        ({"cache": {"writable": False}}, "cannot be written"),
        ({"cache": {"free_space": 5 << 20}}, "nearly full"),
        ({"cpu": {"free_memory": 1 << 30}}, "2 GiB of memory"),
    ],
)
def test_problems_say_what_to_do(change, words, found):
    told = copy.deepcopy(found)
    told["cuda"]["driver_file"], told["cuda"]["seen_by_warp"] = False, len(found["gpus"])
    told["cache"] |= {"writable": True, "free_space": 1 << 40}
    told["cpu"]["free_memory"] = 1 << 40
    assert problems(told) == []
    for part, values in change.items():
        told[part] = values if isinstance(values, list) else told[part] | values
    (sentence,) = problems(told)
    assert words in sentence
