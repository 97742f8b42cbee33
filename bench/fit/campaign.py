"""The studies `formation` and `refusals` in one queue, a line of JSON for each case.

Cases are ordered so that whenever the queue stops, each condition has about the same share of those that it wants.
Lines are written as cases end; the next run goes on from them, and from the rows of both records, on any machine.
`--first` and `--first-image` say where to begin on a machine that has neither; `--budget-s 0` only sums up.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

from sdm.bench.common.json_file import write
from sdm.bench.fit import formation as with_formation
from sdm.bench.fit import refusals as of_refusals
from sdm.bench.fit.case_rows import read_rows, rounded
from sdm.bench.fit.tools import run_cases

# A study's name, the condition ("" where there is one alone), and the number of the case.
Case = tuple[str, str, int]


def campaign(options: argparse.Namespace) -> None:
    """Do what has no line yet, then write the records of both studies."""
    deadline = time.monotonic() + options.budget_s
    done = restore(options) | unpack(options.lines, options.folder)
    before = with_formation.before_rows(_of_study("formation", options).out)
    firsts = {"formation": before["cases"] if before else options.first, "refusals": options.first_image}
    cases = [case for case in queue(options.count, options.images) if case not in done and case[2] >= firsts[case[0]]]
    begin = time.monotonic()
    run_cases(_run, [(case, options, deadline) for case in cases], options.processes)
    found = len(unpack(options.lines, options.folder) - done)
    print(f"{found} cases in {time.monotonic() - begin:.0f} s with {options.processes} processes on {options.device}")
    with_formation.sum_up(_of_study("formation", options))
    of_refusals.sum_up(_of_study("refusals", options))


def restore(options: argparse.Namespace) -> set[Case]:
    """Rows of both records as a file for each case."""
    out = {study: _of_study(study, options).out for study in ("formation", "refusals")}
    found: dict[Case, dict[str, Any]] = {}
    for row in read_rows(with_formation.rows_of(out["formation"])):
        found["formation", row.pop("condition"), row["number"]] = row
    if out["refusals"].is_file():
        for row in json.loads(out["refusals"].read_text())["cases"]:
            found["refusals", "", row["number"]] = row
    for case, row in found.items():
        if not (path := _path(case, options.folder)).is_file():
            write(path, row)
    return set(found)


def queue(count: int, images: int) -> list[Case]:
    """All cases of `count` under each condition and of `images`, the same share of each first."""
    cases: list[tuple[float, Case]] = [
        ((number + 1) / count, ("formation", name, number)) for number in range(count) for name in with_formation.CASES
    ]
    cases += [((number + 1) / images, ("refusals", "", number)) for number in range(images)]
    return [case for _, case in sorted(cases, key=lambda pair: pair[0])]


def unpack(lines: Path, folder: Path) -> set[Case]:
    """Lines as a file for each case, where the studies look for them."""
    done: set[Case] = set()
    for line in read_rows(lines):
        case = (line["study"], line["condition"], line["number"])
        if not (path := _path(case, folder)).is_file():
            write(path, line["record"])
        done.add(case)
    return done


def _path(case: Case, folder: Path) -> Path:
    study, name, number = case
    return folder / study / (f"{name}-{number}.json" if name else f"{number}.json")


def _of_study(study: str, options: argparse.Namespace) -> Namespace:
    """The options that a study by itself would have."""
    count, first = (options.count, options.first) if study == "formation" else (options.images, options.first_image)
    return Namespace(
        folder=options.folder / study, device=options.device, count=count, first=first,
        out=options.out.with_name(f"fit-{study}.json"),
    )  # fmt: skip


def _run(job: tuple[Case, argparse.Namespace, float]) -> None:
    case, options, deadline = job
    if time.monotonic() > deadline:
        return
    study, name, number = case
    own = _of_study(study, options)
    path = _path(case, options.folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    if study == "formation":
        with_formation.run((name, number, own, deadline))
    else:
        of_refusals.run((number, own, deadline))
    if path.is_file():
        record = rounded(json.loads(path.read_text()))
        _append(options.lines, {"study": study, "condition": name, "number": number, "record": record})


def _append(lines: Path, line: dict[str, Any]) -> None:
    """In one write at the end of the file: lines of processes side by side stay whole."""
    lines.parent.mkdir(parents=True, exist_ok=True)
    handle = os.open(lines, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    try:
        os.write(handle, (json.dumps(line) + "\n").encode())
    finally:
        os.close(handle)
