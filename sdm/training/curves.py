"""Curves of a training: JSON lines, and events of TensorBoard."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any


class Curves:
    """Curves as lines of JSON, curve.jsonl, and as TensorBoard's events where that is installed.

    Args:
        folder: Where they go, made if it is not there; None for nowhere.
    """

    def __init__(self, folder: Path | None) -> None:
        self._lines: Path | None = None
        self._board: Any = None
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        self._lines = folder / "curve.jsonl"
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            return
        self._board = SummaryWriter(str(folder))

    def add(self, record: dict[str, float]) -> None:
        """One point of every curve; `record` has the step and the values."""
        if self._lines is None:
            return
        known = {key: value for key, value in record.items() if math.isfinite(value)}
        with self._lines.open("a") as file:
            file.write(json.dumps(known) + "\n")
        if self._board is not None:
            for key, value in known.items():
                if key != "step":
                    self._board.add_scalar(key, value, int(record["step"]))
            self._board.flush()
