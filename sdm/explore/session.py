"""A session in the browser: a server on this machine, which draws until it is ended."""

from __future__ import annotations

import errno
import io
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from importlib import import_module
from typing import Any

from sdm.errors import SDMError
from sdm.explore.controls import Moving, Scene
from sdm.explore.newest_values import NewestValues
from sdm.explore.page import Page

THIS_MACHINE = "127.0.0.1"
TAKEN = "port {port} of {host} is taken: end what listens there, or give another --port"
ENDINGS = ("SIGINT", "SIGTERM", "SIGHUP")


def explore(
    scene: Scene,
    *,
    host: str = THIS_MACHINE,
    port: int = 8080,
    unit: str = "",
    say: Callable[[str], None] = print,
    newest: NewestValues | None = None,
) -> int:
    """Serve a page with a scene until Ctrl-C, the end of the terminal, or `newest.end()`.

    Args:
        scene: What to show: `sdm.explore.scene_of.scene_of` makes one of a name or a file.
        host: Address to listen on; the default is reached from this machine alone.
        port: To listen on.
        unit: Of lengths, for the colour bar, for example "mm".
        say: Takes the address, once the page is there.
        newest: Mailbox of the controls' values, for those who end the session by it.

    Returns:
        How many times the scene was drawn.

    Raises:
        SDMError: viser is not installed, or the port is taken or may not be used.

    All work is done on the calling thread; the server has one of its own, which ends with the session.
    """
    viser = check_place(host, port)
    mailbox = newest or NewestValues()
    with _until_signalled(mailbox), _ended(scene), _server(viser, host, port) as server:
        page = Page(server, scene, mailbox, unit)
        if not mailbox.ended:
            say(address(host, port))
        while not mailbox.ended:
            changed = mailbox.take(page.until_step())
            if changed:
                page.draw(changed)
            if not mailbox.ended:
                page.step()
    return page.drawn


@contextmanager
def _server(viser: Any, host: str, port: int) -> Iterator[Any]:
    """A server of viser's, which prints a table with its address, and a line at its end."""
    with redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="sdm explore", verbose=False)
    try:
        if server.get_port() != port:
            raise SDMError(TAKEN.format(port=port, host=host))
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


@contextmanager
def _ended(scene: Scene) -> Iterator[None]:
    """A scene that is closed after the block, if it moves by itself."""
    try:
        yield
    finally:
        if isinstance(scene, Moving):
            scene.close()


def address(host: str, port: int) -> str:
    """Address to open in a browser, and the way to it from another machine, in words."""
    if host == THIS_MACHINE:
        return (
            f"sdm explore: http://localhost:{port} (Ctrl-C ends it)\n"
            f"from another machine: ssh -L {port}:localhost:{port} {socket.gethostname()}, then the same address there"
        )
    shown = socket.gethostname() if host in ("0.0.0.0", "::") else host  # noqa: S104  as the user asked
    return f"sdm explore: http://{shown}:{port} (Ctrl-C ends it; whoever reaches this address sees the page)"


def check_place(host: str, port: int) -> Any:
    """The module viser, once it is sure that a page can be served there: a taken port would quietly become the next.

    Raises:
        SDMError: viser is not installed, or the port is taken or may not be used.
    """
    try:
        viser = import_module("viser")
    except ImportError:
        raise SDMError("this page needs viser, which is not installed: pip install '.[explore]' in a clone") from None
    if not 1 <= port <= 65535:
        raise SDMError(f"port {port} is no port: give --port 1 to 65535")
    try:
        family, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
    except socket.gaierror:
        raise SDMError(f"{host} is no address of this machine: give --host {THIS_MACHINE}") from None
    except PermissionError:
        raise SDMError(f"port {port} may not be used by this user: give --port 1024 or more") from None
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise SDMError(TAKEN.format(port=port, host=host)) from None
        raise SDMError(f"cannot listen on {host}, port {port}: {error.strerror}") from None
    return viser


@contextmanager
def _until_signalled(mailbox: NewestValues) -> Iterator[None]:
    """End the session at Ctrl-C, `kill`, or when the terminal goes; another Ctrl-C interrupts at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: Any) -> None:
        if mailbox.ended and number == signal.SIGINT:
            raise KeyboardInterrupt
        mailbox.end()

    numbers = [number for name in ENDINGS if (number := getattr(signal, name, None))]
    # What is ignored, as by nohup, stays so.
    before = {n: signal.signal(n, end) for n in numbers if signal.getsignal(n) != signal.SIG_IGN}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
