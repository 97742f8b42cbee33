"""Results as files, whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sdm.io.files.atomic import replacing


def put(path: Path, text: str) -> None:
    """Write text; atomic."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part:
        part.write_text(text)


def write(path: Path, record: dict[str, Any]) -> None:
    """Write JSON; atomic."""
    put(path, json.dumps(record, indent=1) + "\n")
