"""Picture of a pipeline: what each thread of each stage worked at, over time."""

from __future__ import annotations

from pathlib import Path

from sdm.bench.common.figure import drawing
from sdm.runtime.pipeline.stage_times import StageTimes


def draw(times: StageTimes, path: Path, caption: str) -> None:
    """Draw the spans of a run, a row for each thread, stages from top to bottom."""
    stages = list(times.seconds)
    rows = sorted({(stages.index(span.stage), span.thread) for span in times.spans})
    place = {row: number for number, row in enumerate(rows)}
    colours = ("#4477aa", "#cc6677", "#ddaa33", "#117733")
    with drawing(path, caption) as (_, axes):
        for span in times.spans:
            stage = stages.index(span.stage)
            at = place[stage, span.thread]
            colour = colours[stage % len(colours)]
            axes.barh(
                at, span.end - span.begin, left=span.begin, height=0.8, color=colour, edgecolor="white", linewidth=0.3
            )
        axes.set_yticks(range(len(rows)), [f"{stages[stage]} {thread + 1}" for stage, thread in rows])
        axes.invert_yaxis()
        axes.set_xlabel("seconds since the start")
        axes.set_title("Stages of a pipeline, beside each other", loc="left")
