from __future__ import annotations

import os
import pty
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import sdm
from sdm.cli import main
from sdm.errors import SDMError
from sdm.explore.map_scene import LEVEL, MapScene
from sdm.explore.newest_values import NewestValues
from sdm.explore.page import ACROSS, DRAGGED, OPEN, PLACE, PLANE, Page
from sdm.explore.session import address, check_place, explore
from tests.helpers.chromium import chromium, open_tab, wait_for

# Makes its standard input the terminal that it ends with, as a login does.
ON_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""
NO_VISER = "viser is not installed: pip install '.[explore]'"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def session(root):
    """A session of a small family in a process of its own, on a terminal that the last test closes."""
    pytest.importorskip("viser", reason=NO_VISER)
    port = free_port()
    program = [sys.executable, "-m", "sdm.cli", "explore", "ellipsoid", "--resolution", "16", "--device", "cpu"]
    shown, terminal = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", ON_TERMINAL, *program, "--port", str(port)],
        cwd=root,
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        start_new_session=True,
    )
    os.close(terminal)
    try:
        said = b""
        while said.count(b"\n") < 2:
            said += os.read(shown, 4096)
        assert f"http://localhost:{port}" in said.decode()
        assert f"ssh -L {port}:localhost:{port}" in said.decode()
        yield process, port, shown
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def flat_map() -> MapScene:
    grid = sdm.Grid((0, 0, 0), (1, 1, 1), (4, 4, 4))
    values = np.linspace(-1, 1, 64, dtype=np.float32).reshape(4, 4, 4)
    return MapScene("map", lambda number: sdm.SDM(values, grid))


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_ends_it_and_no_thread_is_left(flat_map, name):
    pytest.importorskip("viser", reason=NO_VISER)
    before, port = set(threading.enumerate()), free_port()
    handler = signal.getsignal(getattr(signal, name))
    said = []

    def say(line: str) -> None:
        said.append(line)
        signal.raise_signal(getattr(signal, name))

    assert explore(flat_map, port=port, say=say) == 1
    assert len(said) == 1
    assert signal.getsignal(getattr(signal, name)) == handler
    assert not [thread for thread in threading.enumerate() if thread not in before]
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0


def test_what_is_put_is_drawn(flat_map):
    pytest.importorskip("viser", reason=NO_VISER)
    newest = NewestValues()
    values = {LEVEL: 0.5, PLACE: 0.2, ACROSS: "z", OPEN: True, PLANE: True}

    def say(line: str) -> None:
        for name, value in values.items():
            newest.put(name, value)
        threading.Timer(0.5, newest.end).start()

    assert explore(flat_map, port=free_port(), say=say, newest=newest) == 2


def test_the_arrow_of_the_plane_moves_its_slider(flat_map):
    viser = pytest.importorskip("viser", reason=NO_VISER)
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    try:
        page = Page(server, flat_map, NewestValues())
        for place, share in ((3.0, 1.0), (0.6, 0.2), (-9.0, 0.0)):
            page.draw({DRAGGED: np.array([0.0, place, 0.0])})
            assert page.plane[PLACE] == pytest.approx(share)
    finally:
        server.stop()


def test_what_is_ignored_stays_so(flat_map):
    """As `nohup` asks."""
    pytest.importorskip("viser", reason=NO_VISER)
    newest, before = NewestValues(), signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:

        def say(line: str) -> None:
            signal.raise_signal(signal.SIGHUP)
            assert not newest.ended
            newest.end()

        assert explore(flat_map, port=free_port(), say=say, newest=newest) == 1
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_it_listens_on_this_machine_only(session):
    _, port, _ = session
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    listening = {row[1] for row in rows if row[3] == "0A"}
    assert f"0100007F:{port:04X}" in listening
    assert f"00000000:{port:04X}" not in listening


def test_a_taken_port_is_one_sentence(capsys):
    pytest.importorskip("viser", reason=NO_VISER)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert main(["explore", "cochlea", "--port", str(port)]) == 2
    said = capsys.readouterr()
    assert said.err == f"sdm: port {port} of 127.0.0.1 is taken: end what listens there, or give another --port\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--stream", "--fit", "scan.nii.gz"], "--stream and --fit are two scenes: give one of them"),
        (["--stream", "--surrogate", "folder"], "--surrogate is for sliders"),
        (["--fit", "nothing.nii.gz"], "nothing.nii.gz"),
        (["--surrogate", "nothing"], "nothing"),
    ],
)
def test_what_does_not_go_together_is_one_sentence(capsys, words, said):
    pytest.importorskip("viser", reason=NO_VISER)
    assert main(["explore", "cochlea", "--port", str(free_port()), *words]) == 2
    found = capsys.readouterr().err
    assert said in found
    assert len(found.splitlines()) == 1


def test_places_where_no_page_can_be(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(SDMError, match="needs viser"):
        check_place("127.0.0.1", 8080)
    monkeypatch.setitem(sys.modules, "viser", os)
    with pytest.raises(SDMError, match="no port"):
        check_place("127.0.0.1", 0)
    with pytest.raises(SDMError, match="cannot listen"):
        check_place("192.0.2.1", free_port())


def test_the_address():
    assert "whoever reaches" in address("0.0.0.0", 80)
    assert "ssh -L 8080:localhost:8080" in address("127.0.0.1", 8080)


@pytest.mark.skipif(chromium() is None, reason="Chromium is not installed (Debian: apt install chromium)")
def test_a_slider_moves_the_surface_in_a_browser(session, tmp_path):
    _, port, _ = session
    with open_tab(f"http://127.0.0.1:{port}", tmp_path, size=(640, 400)) as tab:
        tab.wait_for("document.querySelector('canvas') !== null && document.body.innerText.includes('volume')")
        note = "document.body.innerText.match(/volume ([0-9.]+)/)[1]"
        before = tab.value(note)
        tab.value("document.querySelectorAll('[role=slider]')[0].focus()")
        for _ in range(20):
            tab.press("ArrowRight", 39)
        wait_for(lambda: tab.value(note) != before, "another surface")
        assert tab.picture()[:4] == b"\x89PNG"
        assert tab.errors == []


def test_it_ends_with_its_terminal(session):
    process, _, shown = session
    os.close(shown)
    assert process.wait(timeout=30) == 0
