"""A user's own mesh and peer, as bench/README.md shows them; and what is said of a file that holds neither."""

from __future__ import annotations

import json
import re

import pytest

import sdm
from sdm.bench.common.own import load_own
from sdm.cli.commands import bench as command

pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture
def mine(root, tmp_path):
    page = (root / "bench" / "README.md").read_text()
    path = tmp_path / "mine.py"
    path.write_text(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1])
    return path


def test_the_readmes_example_runs(mine, tmp_path, capsys):
    out = tmp_path / "comparison"
    code = command.bench(add=(mine,), peers=("sdm", "ball"), resolutions=(6, 8), device="cpu", quick=True, out=out)
    assert code == 0
    assert "fine ball at 8^3 (16,128 triangles)" in capsys.readouterr().out
    assert {p.name for p in out.iterdir()} == {"results.json", "report.md", "results-speed.png", "results-growth.png"}
    rows = json.loads((out / "results.json").read_text())["results"][0]["rows"]
    assert [row["peer"] for row in rows] == ["sdm", "ball formula"]
    # The formula is of a ball, not of the mesh: nearly right, and told so.
    assert rows[0]["fine"]
    assert not rows[1]["fine"]
    assert "sdm is faster by" in (out / "report.md").read_text()


def test_what_a_file_holds(mine):
    own = load_own([mine])
    assert list(own.cases) == ["fine ball"]
    assert [peer.name for peer in own.peers("cpu")] == ["ball formula"]


def test_a_peer_that_asks_for_the_device_is_told(tmp_path):
    path = tmp_path / "two.py"
    path.write_text(
        "from sdm.bench.peers import StockWarp\n"
        "class Mine(StockWarp):\n"
        "    name = 'mine'\n"
        "    def __init__(self, device):\n"
        "        super().__init__(device)\n"
    )
    (peer,) = load_own([path]).peers("cpu")
    assert (peer.name, peer.device) == ("mine", "cpu")


def test_bad_files_are_one_sentence(tmp_path):
    with pytest.raises(sdm.FormatError, match="there is no file"):
        load_own([tmp_path / "none.py"])
    empty = tmp_path / "empty.py"
    empty.write_text("from sdm.bench.common.own import OwnMesh\n")
    with pytest.raises(sdm.FormatError, match="no class that inherits"):
        load_own([empty])


def test_commands_of_the_page_exist(root):
    import importlib.util

    page = (root / "bench" / "README.md").read_text()
    for module in re.findall(r"python -m (sdm\.bench[\w.]*\w)", page):
        assert importlib.util.find_spec(module), module


def test_the_pages_command_runs(root, tmp_path, monkeypatch):
    from sdm.cli import main

    page = (root / "bench" / "README.md").read_text()
    (line,) = re.search(r"```sh\n(.*?)```", page, re.DOTALL)[1].splitlines()
    monkeypatch.chdir(tmp_path)
    assert main(line.split()[1:]) == 0
    assert (tmp_path / "comparison" / "report.md").is_file()
