"""JSON files, whole or not there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from sdm.core.given_values import as_path
from sdm.io.files.atomic import replacing


def write_json(path: str | Path, content: Any) -> None:
    """Write plain numbers, texts, lists and dictionaries as JSON, a line each; atomic.

    Raises:
        FormatError: The place cannot be written.
    """
    with replacing(as_path(path)) as part:
        part.write_text(json.dumps(content, indent=1) + "\n")
