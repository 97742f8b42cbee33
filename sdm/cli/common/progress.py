"""Progress on stderr, where someone is looking."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Self


class Bar:
    """A progress bar over `total` meshes; nothing at all unless stderr is a terminal.

    Use as a context manager. It disappears when done.
    """

    def __init__(self, total: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        self._progress = Progress(
            *columns,
            console=console,
            transient=True,
            disable=not console.is_terminal,
            # Lines go above the bar where both are on the screen, and into their file where they are not.
            redirect_stdout=sys.stdout.isatty(),
        )
        self._total = total
        self._done = 0
        self._task = self._progress.add_task("", total=None)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def begin(self, name: str) -> None:
        """The next mesh, by name."""
        # One map alone has no share to show until a slab is written.
        total = None if self._total == 1 else self._total
        self._progress.update(self._task, description=name, total=total, completed=self._done)

    def share(self, done: float) -> None:
        """How much of the mesh is done, 0 to 1."""
        self._progress.update(self._task, total=self._total, completed=self._done + done)

    def end(self) -> None:
        """The mesh is done."""
        self._done += 1
        self._progress.update(self._task, completed=self._done)

    def print(self, line: str, *, warn: bool = False) -> None:
        """A line that stays: on stdout, or on stderr if it is a warning."""
        print(line, file=sys.stderr if warn else sys.stdout, flush=True)
