"""Files of a dataset: whole under their final name, or not there, and on the disk before anything says so."""

from __future__ import annotations

import os
from pathlib import Path

from sdm.io.files.atomic import own_name


def put(target: Path, content: bytes | Path) -> None:
    """Write bytes, or move a file that is on the same disk, to `target`."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, Path):
        _flush(content)
        content.replace(target)
    else:
        part = own_name(target)
        try:
            part.write_bytes(content)
            _flush(part)
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)
    _flush(target.parent)


def _flush(path: Path) -> None:
    # Also for folders: without it a power cut may forget the renaming.
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
