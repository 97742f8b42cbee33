"""NumPy archives that are written whole or not at all, and always to the same bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sdm.io.files.atomic import replacing


def write_npz(path: Path, **arrays: Any) -> None:
    """Write arrays under their names, not compressed; folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as part, part.open("wb") as file:
        contents: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
        np.savez(file, **contents)
