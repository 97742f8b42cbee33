"""Files that a command makes something of one after the other, with progress, and what became of them at the end."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sdm.cli.common.failed_item import reason_of, tell_failed
from sdm.cli.common.progress import FileProgress
from sdm.io.files.stand_in import fetched, shown
from sdm.runtime.pipeline.outcome import Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.pipeline.stages import numbered, one_by_one


def one_after_other(
    jobs: list[tuple[Path, Path]], stage: str, write: Callable[[Path, Path, FileProgress], None], one: str, many: str
) -> int | None:
    """Write what is made of each file; the exit code, 2 if some failed, which is said at the end.

    Args:
        jobs: Pairs of a file to read, which is fetched if it is at an address, and one to write.
        stage: Name of the work.
        write: Does it.
        one: What a file to read is called, and `many` of several.
        many: Several.

    Raises:
        SDMError: That of a file that is the only one, or a full disk.
    """
    failed: list[tuple[str, str]] = []
    with FileProgress(len(jobs)) as progress:

        def written(job: tuple[Path, Path]) -> None:
            progress.begin(job[0].name)
            with fetched(job[0]):
                write(*job, progress)

        for outcome in one_by_one(numbered(jobs), stage, written, times=StageTimes()):
            if isinstance(outcome, Failed):
                reason = reason_of(outcome, alone=len(jobs) == 1, resumed=False)
                failed.append((shown(jobs[outcome.number][0]), reason))
            progress.end()
    return tell_failed(failed, len(jobs), one, many)
