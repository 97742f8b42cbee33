"""Last lines about many meshes: counts, in words that fit them."""

from __future__ import annotations

import pytest

from sdm.cli.maps.mesh_report import MeshEntry
from sdm.cli.maps.run import sum_up

DONE, FAILED = MeshEntry(mesh="a.ply", state="done"), MeshEntry(mesh="b.ply", state="failed", reason="b.ply is empty")


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ([DONE, FAILED], "sdm: 1 of 2 meshes failed; the others are done"),
        ([FAILED, FAILED], "sdm: 2 of 2 meshes failed"),
        ([FAILED], "sdm: the only mesh failed"),
    ],
)
def test_others_are_done_where_there_are_any(entries, said, capsys):
    assert sum_up(entries, skip_bad=False) == 2
    assert capsys.readouterr().err.splitlines()[-1] == said


def test_a_table_of_one(capsys):
    assert sum_up([DONE], skip_bad=True) is None
    assert capsys.readouterr().out == "1 mesh: 1 done\n"
