"""Progress of long work on stderr: a bar on a terminal, and a line now and then in a log."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from sdm.cli.common.printed_line import print_line, printable

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from sdm.runtime.pipeline.stage_times import StageTimes

# Seconds between the lines in a log.
LOG_INTERVAL = 30.0


class _Bar:
    """rich's bar, drawn on a terminal alone, and imported only there. A context manager.

    Args:
        elapsed: Show the time since the start.
        transient: Remove the bar when the work is done.
    """

    def __init__(self, *, elapsed: bool, transient: bool) -> None:
        self._elapsed, self._transient = elapsed, transient
        self._drawn: tuple[Progress, TaskID] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._drawn is not None:
            self._drawn[0].stop()

    @property
    def on_terminal(self) -> bool:
        """True where a bar is drawn."""
        # Once it is, stderr is a proxy of rich's, which before rich 15 says that it is no terminal.
        return self._drawn is not None or sys.stderr.isatty()

    def draw(self, text: str, done: float, total: float | None) -> None:
        """Show `done` of `total`; a total that is None draws a bar that only moves."""
        if not self.on_terminal:
            return
        if self._drawn is None:
            self._drawn = self._start()
        progress, task = self._drawn
        progress.update(task, description=printable(text), total=total, completed=done)

    def _start(self) -> tuple[Progress, TaskID]:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            *([TimeElapsedColumn()] if self._elapsed else []),
            console=Console(stderr=True),
            transient=self._transient,
            # Lines go above the bar where both are on the screen, and into their file where they are not.
            redirect_stdout=sys.stdout.isatty(),
        )
        progress.start()
        return progress, progress.add_task("", total=None)


class StageProgress(_Bar):
    """Names of the steps of work whose length is not known, beside the time that it has taken; called with each."""

    def __init__(self) -> None:
        super().__init__(elapsed=True, transient=True)
        self._begun = self._logged = time.monotonic()

    def __call__(self, stage: str, step: int, *_: object) -> None:
        """A stage's step, by number; what else the work tells of it is left out."""
        text, now = f"{stage}, step {step}", time.monotonic()
        if self.on_terminal:
            self.draw(text, 0, None)
        elif now - self._logged >= LOG_INTERVAL:
            print(f"sdm: {text}, {now - self._begun:.0f} s", file=sys.stderr, flush=True)
            self._logged = now


class FileProgress(_Bar):
    """Progress over `total` files, each with the share of it that is done.

    Args:
        total: Number of files.
        times: The clock of the pipeline that they go through, to name the stage that the others wait for.
    """

    def __init__(self, total: int, times: StageTimes | None = None) -> None:
        super().__init__(elapsed=True, transient=True)
        self._times, self._begun = times, time.monotonic()
        self._total = total
        self._done = 0
        self._name = self._more = ""

    def begin(self, name: str) -> None:
        """The next file, by name."""
        self._name = f"{name}{self._more}"
        # Of one file alone there is no share to show until a slab is written.
        self.draw(self._name, self._done, None if self._total == 1 else self._total)

    def share(self, done: float) -> None:
        """The share of the file that is done, 0 to 1."""
        self.draw(self._name, self._done + done, self._total)

    def end(self) -> None:
        """The file is done."""
        self._done += 1
        pace = _pace(self._done, self._total - self._done, time.monotonic() - self._begun)
        self._more = f"{pace}{_limit(self._times)}" if self._total > 1 else ""
        self.draw(self._name, self._done, self._total)

    def print(self, line: str, *, warn: bool = False) -> None:
        """Print a line that stays: on stdout, or on stderr if it is a warning."""
        print_line(line, error=warn)


class CountProgress(_Bar):
    """Progress of a count, with rate and time left; called with the number done and the number there are.

    Args:
        unit: What is counted.
        times: The clock of the pipeline behind it, to name the stage that the others wait for.
        budget_s: Seconds after which the count ends wherever it is.

    What is done at the first call does not count for the rate.
    """

    def __init__(self, unit: str, times: StageTimes | None = None, *, budget_s: float | None = None) -> None:
        super().__init__(elapsed=False, transient=False)
        self._unit, self._times, self._budget_s = unit, times, budget_s
        self._start_of_rate: tuple[float, int] | None = None
        self._logged = 0.0

    def __call__(self, done: int, total: int, unit: str | None = None) -> None:
        """`done` of `total`; another unit than before is another count."""
        now = time.monotonic()
        if unit is not None and unit != self._unit:
            self._unit, self._start_of_rate = unit, None
        if self._start_of_rate is None:
            self._start_of_rate, self._logged = (now, done), now
            return
        start, first = self._start_of_rate
        made, seconds, share = done - first, now - start, done / max(total, 1)
        count = f"{done:,} of {total:,} {self._unit}"
        pace = _pace(made, total - done, seconds)
        if self._budget_s is not None and seconds / self._budget_s > share:
            # The clock ends it, not the count.
            left, share = max(0.0, self._budget_s - seconds), min(1.0, seconds / self._budget_s)
            count, pace = f"{done:,} {self._unit}", _pace(made, left * made / max(seconds, 1e-9), seconds)
        line = f"{count}{pace}{_limit(self._times)}"
        if self.on_terminal:
            self.draw(line, share, 1.0)
        elif now - self._logged >= LOG_INTERVAL:
            print(f"sdm: {line}", file=sys.stderr, flush=True)
            self._logged = now


def _limit(times: StageTimes | None) -> str:
    limit = None if times is None else times.limit()
    return f", {limit} limits" if limit else ""


def _pace(made: int, left: float, seconds: float) -> str:
    if made <= 0 or seconds <= 0:
        return ""
    rate = made / seconds
    minutes, rest = divmod(int(left / rate), 60)
    hours, minutes = divmod(minutes, 60)
    return f", {rate:,.3g} a second, {hours}:{minutes:02}:{rest:02} left"
