"""`sdm bench`: compare with the other libraries on this machine."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.argument_types import Device

# Benchmarks with words of their own, each a module with a `main` that takes these.
PROGRAMS = {"zoo": "sdm.bench.zoo.__main__", "zoo-speed": "sdm.bench.zoo.speed"}


def program(words: Sequence[str]) -> Callable[[], int] | None:
    """The benchmark that the words after `sdm bench` begin with the name of; None if they are options of `bench`."""
    if not words or words[0] not in PROGRAMS:
        return None
    return partial(importlib.import_module(PROGRAMS[words[0]]).main, words[1:])


def bench(
    meshes: tuple[str, ...] = (),
    resolutions: tuple[int, ...] = (),
    points: int = 0,
    peers: tuple[str, ...] = (),
    device: Device = "auto",
    runs: int = 5,
    budget_s: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 30.0,
    quick: bool = False,
    out: Annotated[
        Path | None, tyro.conf.arg(aliases=["-o"], metavar="PATH", help_behavior_hint="(default: none)")
    ] = None,
    add: tuple[Path, ...] = (),
) -> int:
    """Time sdm and every other library that is installed, each checked against a float64 brute force first.

    Folders of meshes as they come: `sdm bench zoo FOLDER` (is each measured right?) and `sdm bench zoo-speed FOLDER`
    (how fast is each one's first map beside stock Warp?), each with a `--help` of its own.

    The extra `bench` brings the other libraries: `pip install ".[bench]"` in a clone.

    Args:
        meshes: Mesh files, names from bench/common/meshes.py, or torus-N for a torus of N triangles; a choice if not
            given.
        resolutions: Voxels along each axis of the grids; 16 to 256 if not given, as the device and --quick suggest.
        points: Also query this many scattered points, half of them near the surface.
        peers: Only peers whose name holds one of these words, for example sdm warp libigl.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
        runs: Timed calls for each figure; the median counts.
        budget_s: About how many seconds one peer may take for one mesh and grid; slower ones answer fewer points.
        quick: Small choices: under a minute on two cores.
        out: Also write results.json, tables and log-log plots to this folder; only the results if it ends with .json.
        add: Python files with a class for each mesh or peer of yours to compare too; bench/README.md has an example.
    """
    from sdm.bench.dense.compare import Options, run

    return run(
        Options(
            device=None if device == "auto" else device,
            meshes=meshes or None,
            resolutions=resolutions or None,
            points=points,
            peers=peers or None,
            runs=runs,
            budget_s=budget_s,
            quick=quick,
            out=out,
            add=add,
        )
    )
