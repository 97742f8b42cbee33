"""Files by addresses, not paths: `s3://`, `gs://`, `https://`, `memory://` and what else fsspec knows."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from sdm.core.given_values import as_path
from sdm.errors import FormatError, SDMError, one_line

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

# Two letters at least: one is a drive of Windows.
ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")


def is_remote(path: Any) -> bool:
    """True of text that begins with a protocol. A `Path` has lost one of its slashes, and is a file here."""
    return isinstance(path, str) and ADDRESS.match(path) is not None


def place_of(path: str | Path) -> Path:
    """The path, or of an address a `RemotePath`, which answers what readers of datasets ask of a path."""
    return cast("Path", RemotePath(str(path))) if is_remote(path) else as_path(path)


class RemotePath:
    """A file or folder by its address, with those methods of `pathlib.Path` that reading needs.

    Args:
        address: With its protocol.

    Raises:
        FormatError: The protocol is not known, or the package for it not installed; from the methods, what the server
            refuses.
    """

    def __init__(self, address: str) -> None:
        self._address = address.rstrip("/")
        # Now, so that an address that nobody can open is told at once.
        _ = self._there

    @property
    def _there(self) -> tuple[AbstractFileSystem, str]:
        # fsspec remembers it, by process: an open connection is not that of a fork.
        return file_system(self._address)

    def __str__(self) -> str:
        return self._address

    def __repr__(self) -> str:
        return f"RemotePath({self._address!r})"

    def __truediv__(self, name: str) -> RemotePath:
        return RemotePath(f"{self._address}/{name}")

    def joinpath(self, *names: str) -> RemotePath:
        """As of a path."""
        return RemotePath("/".join([self._address, *names]))

    @property
    def name(self) -> str:
        """The last part."""
        return PurePosixPath(self._there[1]).name

    def with_name(self, name: str) -> RemotePath:
        """Another name beside this one."""
        return RemotePath(f"{self._address[: len(self._address) - len(self.name)]}{name}")

    def exists(self) -> bool:
        """True if something is there."""
        with asking(self._address):
            return self._there[0].exists(self._there[1])

    def is_file(self) -> bool:
        """True if it is a file."""
        with asking(self._address):
            return self._there[0].isfile(self._there[1])

    def stat(self) -> SimpleNamespace:
        """Its size, as `st_size`."""
        with asking(self._address):
            return SimpleNamespace(st_size=self._there[0].size(self._there[1]))

    def read_text(self) -> str:
        """All of it as text."""
        content: Any
        with asking(self._address):
            content = self._there[0].cat_file(self._there[1])
        return content.decode()


def file_system(address: str) -> tuple[AbstractFileSystem, str]:
    """fsspec's file system of an address, and the path in it.

    Raises:
        FormatError: fsspec, or its package for the protocol, is not installed, or it knows no such protocol.
    """
    try:
        from fsspec.core import url_to_fs

        return url_to_fs(address)
    except ImportError as error:
        raise FormatError(f"{address} cannot be opened: {one_line(error)} (extra remote)") from error
    except ValueError as error:
        raise FormatError(f"{address} cannot be opened: {one_line(error)}") from error


@contextmanager
def asking(address: str) -> Iterator[None]:
    """Errors of a server, of whatever class, as one sentence; that something is not there stays what it is.

    Raises:
        FormatError: The server cannot be reached, or refuses.
    """
    try:
        yield
    except (SDMError, MemoryError, FileNotFoundError, UnicodeDecodeError):
        raise
    except Exception as error:
        raise FormatError(f"{address} cannot be read or written: {one_line(error)}") from error


@contextmanager
def local_copy(address: str) -> Iterator[Path]:
    """A copy of a file or folder, under its own name in a folder that is gone afterwards.

    Raises:
        FormatError: It is not there, or cannot be read.
    """
    files, path = file_system(address)
    with tempfile.TemporaryDirectory(prefix="sdm-") as folder:
        local = Path(folder) / PurePosixPath(path).name
        try:
            with asking(address):
                if files.isdir(path):
                    files.get(path, str(local), recursive=True)
                else:
                    files.get_file(path, str(local))
        except FileNotFoundError:
            raise FormatError(f"there is no file {address}") from None
        with named_by(local, address):
            yield local


@contextmanager
def local_for(address: str) -> Iterator[Path]:
    """A place for a file or folder, which is brought to its address after the block, in place of what is there.

    Raises:
        FormatError: It cannot be written.
    """
    files, path = file_system(address)
    with tempfile.TemporaryDirectory(prefix="sdm-") as folder:
        local = Path(folder) / PurePosixPath(path).name
        with named_by(local, address):
            yield local
        with asking(address):
            if local.is_dir():
                if files.exists(path):
                    files.rm(path, recursive=True)
                files.put(str(local), path, recursive=True)
            else:
                files.put_file(str(local), path)


@contextmanager
def named_by(local: Path, address: str) -> Iterator[None]:
    """Sentences of errors about a copy name what it is a copy of."""
    try:
        yield
    except SDMError as error:
        raise type(error)(str(error).replace(str(local), address)) from error
