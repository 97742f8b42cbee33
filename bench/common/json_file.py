"""Results as files, whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sdm.io.files.atomic import replacing
from sdm.io.files.json_file import write_json


def put(path: Path, text: str) -> None:
    """Write text; atomic."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_text(text)


def write(path: Path, record: dict[str, Any]) -> None:
    """Write JSON; atomic."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, record)
