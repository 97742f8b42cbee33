"""Archives of mesh files: .zip, .tar.gz, .tar.bz2 and a single file as .gz or .bz2."""

from __future__ import annotations

import bz2
import gzip
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO

from sdm.errors import MeshError

# An archive may unpack to this many bytes, or to so many times its own size: text shrinks to a tenth, zeros to a
# thousandth.
ALWAYS_FITS = 1 << 26
MOST_TIMES = 100
BLOCK = 1 << 20


@contextmanager
def unpacked(path: Path, ending: str) -> Iterator[Path]:
    """A temporary folder with the files of an archive.

    Raises:
        MeshError: It would be far larger than the archive, or a file of it would lie outside.
    """
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        budget = _Budget(path)
        if ending == "zip":
            _unpack_zip(path, folder, budget)
        elif ending.startswith("tar"):
            _unpack_tar(path, folder, budget)
        else:
            with gzip.open(path) if ending == "gz" else bz2.open(path) as file:
                budget.copy(file, folder / path.name[: -len(f".{ending}")])
        yield folder


def check_zip(path: Path) -> None:
    """Refuse a zip file, of whatever ending, that would unpack to far more than it is.

    Raises:
        MeshError: It would.
    """
    with zipfile.ZipFile(path) as archive:
        _Budget(path).take(sum(info.file_size for info in archive.infolist()))


class _Budget:
    """Bytes that an archive may still unpack to."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.whole = self.left = max(ALWAYS_FITS, MOST_TIMES * path.stat().st_size)

    def take(self, size: int) -> None:
        self.left -= size
        if self.left < 0:
            raise MeshError(f"{self.path} unpacks to more than {self.whole >> 20} MiB, {MOST_TIMES} times its size")

    def copy(self, source: IO[bytes] | gzip.GzipFile, target: Path) -> None:
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("wb") as file:
            while block := source.read(BLOCK):
                self.take(len(block))
                file.write(block)


def _unpack_zip(path: Path, folder: Path, budget: _Budget) -> None:
    with zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            if not info.is_dir():
                with archive.open(info) as file:
                    budget.copy(file, _inside(folder, info.filename, path))


def _unpack_tar(path: Path, folder: Path, budget: _Budget) -> None:
    # As a stream, since a list of its files would be read to the end first, and through files that unpack a little at a
    # time.
    opened = gzip.open if path.name.lower().endswith(".gz") else bz2.open
    with opened(path) as plain, tarfile.open(fileobj=plain, mode="r|") as archive:
        for info in archive:
            file = archive.extractfile(info) if info.isfile() else None
            # What is skipped is unpacked too.
            budget.take(0 if info.isfile() else info.size)
            if file is not None:
                budget.copy(file, _inside(folder, info.name, path))


def _inside(folder: Path, name: str, path: Path) -> Path:
    parts = PurePosixPath(name.replace("\\", "/"))
    if parts.is_absolute() or ".." in parts.parts:
        raise MeshError(f"{path} has a file that would lie outside of it: {name[:100]!r}")
    return folder / parts
