"""Lines of JSON that grow while a folder is being made, so that a run that was cut off can go on.

At an address the file is brought there now and then.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from sdm.errors import FormatError
from sdm.io.files.stand_in import address_of, bring, gone

NAME = "unfinished.jsonl"
# Between two times that the file is brought to its address.
SECONDS = 5.0


class LineFile:
    """Dictionaries, a line each, in the file `unfinished.jsonl` of a folder.

    Args:
        folder: Where the file is.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME
        self._is_far = address_of(folder) is not None
        self._brought, self._pause = time.monotonic(), SECONDS
        self._file: IO[str] | None = None

    def read(self) -> Iterator[dict[str, Any]]:
        """Lines of a run before; those that are torn or damaged are left out."""
        with contextlib.suppress(OSError):
            for line in self.path.read_text(encoding="utf-8", errors="replace").splitlines():
                with contextlib.suppress(ValueError):
                    if isinstance(found := json.loads(line), dict):
                        yield found

    def add(self, line: dict[str, Any]) -> None:
        """Append a line.

        Raises:
            FormatError: The file cannot be written.
        """
        try:
            if self._file is None:
                self._file = self.path.open("a", encoding="utf-8")
                # The line before may be torn.
                self._file.write("\n")
            self._file.write(json.dumps(line) + "\n")
            self._file.flush()
        except OSError as error:
            raise FormatError(f"{self.path} cannot be written: {error.strerror or error}") from error
        if self._is_far and time.monotonic() > self._brought + self._pause:
            begin = time.monotonic()
            bring(self.path, keep=True)
            self._brought = time.monotonic()
            # All of it goes each time, and is to be little beside what it tells of.
            self._pause = max(SECONDS, 20 * (self._brought - begin))

    def close(self, *, whole: bool) -> None:
        """End the file: it goes if all is done (`whole`), and stays otherwise."""
        if self._file is not None:
            self._file.close()
            self._file = None
        if not self.path.exists():
            return
        if whole:
            self.remove()
        else:
            bring(self.path, keep=True)

    def remove(self) -> None:
        """Take the file away."""
        # Another command may write to the same folder.
        self.path.unlink(missing_ok=True)
        gone(self.path)
