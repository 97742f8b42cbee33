"""Options of one number or three."""

from __future__ import annotations

import pytest
import trimesh

import sdm
from sdm.cli import main
from sdm.cli.common.numbers import joined


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("compute --resolution 64 64 32 a.ply", "compute --resolution 64,64,32 a.ply"),
        ("compute --resolution 64,64,32 a.ply", "compute --resolution 64,64,32 a.ply"),
        ("compute --spacing .5 1e-1 2. --margin 0.1 7", "compute --spacing .5,1e-1,2. --margin 0.1 7"),
        ("view a.ply --resolution 64", "view a.ply --resolution 64"),
        ("compute 1 2 --resolution", "compute 1 2 --resolution"),
        ("compute --resolution a.ply 1 2", "compute --resolution a.ply 1 2"),
        ("compute --resolution -5 3d.ply", "compute --resolution -5 3d.ply"),
    ],
)
def test_words_are_joined(words, expected):
    assert joined(words.split()) == expected.split()


@pytest.mark.parametrize("words", ["--resolution 6 5 4", "--resolution 6,5,4", "--resolution=6,5,4"])
def test_three_numbers(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    trimesh.creation.icosphere(1).export("ball.ply")
    assert main(["compute", *words.split(), "ball.ply", "-o", "map.npz"]) is not None
    assert sdm.load("map.npz").grid == sdm.Grid.around("ball.ply", (6, 5, 4))
