"""Foreign meshes, one after the other: is each measured right, or refused in one sentence?

    python -m sdm.bench.zoo FOLDER --device cpu --out bench/results/zoo-cpu.json

For each file with the ending of a mesh, in the folder and in those in it: what the mesh is like, by which method inside
is told, how random points and voxels agree with a float64 brute force over all triangles, and milliseconds of the first
map and of repeated ones (vertices and faces to map; the fastest) beside stock Warp's query, by the faster of its trees.
Or the sentence that refused it. The exit code is 1 if a value or a sign was wrong, something else than a sentence came
out, or a file took longer than the limit.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sdm.bench.common import json_file
from sdm.bench.common.machine import describe
from sdm.bench.zoo.folder import files_of, other_endings
from sdm.bench.zoo.page import page
from sdm.bench.zoo.trial import trial
from sdm.bench.zoo.worker import Worker
from sdm.core.device import choose_device
from sdm.errors import SDMError


def main(argv: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="mesh files, or .npz with vertices and faces, also in folders in it")
    parser.add_argument("--device", help="cpu or cuda (default: cuda if there)")
    parser.add_argument("--resolution", type=int, default=64, help="voxels along each axis of the maps")
    parser.add_argument("--points", type=int, default=200, help="points, and voxels, that are checked of each mesh")
    parser.add_argument("--limit-s", type=float, default=300.0, help="seconds after which a file is given up")
    parser.add_argument("--out", type=Path, help="JSON file; a table as Markdown beside it")
    given = parser.parse_args(argv)
    try:
        device = str(choose_device(given.device))
        files = list(files_of(given.folder))
    except SDMError as error:
        print(f"sdm: {error}", file=sys.stderr)
        return 2
    made_on = describe(device)
    rows: list[dict[str, Any]] = []
    worker = Worker(trial, given.limit_s)
    for number, found in enumerate(files, 1):
        result = worker(found, device, given.resolution, given.points)
        row = {"mesh": found.name, "broken": result} if isinstance(result, str) else result
        # Where the folder lies on this machine is nobody's business.
        row = {key: _without(value, f"{given.folder}/") for key, value in row.items()}
        rows.append(row)
        print(f"[{number}/{len(files)}] {sentence(row)}", flush=True)
        report = {
            "machine": made_on,
            "resolution": given.resolution,
            "endings_not_read": other_endings(given.folder),
            "summary": summary(rows),
            "rows": rows,
        }
        if given.out and (number == len(files) or number % 20 == 0):
            json_file.write(given.out, report)
            json_file.put(given.out.with_suffix(".md"), page(report))
    worker.close()
    found = summary(rows)
    print(", ".join(f"{count} {name.replace('_', ' ')}" for name, count in found.items()))
    return int(found["broken"] + found["wrong"] > 0)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Numbers of files that were measured right, were refused, broke something or had a wrong value."""
    measured = [row for row in rows if "checked" in row]
    return {
        "files": len(rows),
        "refused": sum("refused" in row for row in rows),
        "measured": len(measured),
        "points_and_voxels": sum(row["checked"]["points"] for row in measured),
        "wrong": sum(is_wrong(row) for row in measured),
        "broken": sum("broken" in row or "stray_warnings" in row for row in rows),
        "worst_roundings": max((row["checked"]["max_error"] or 0.0 for row in measured), default=0.0),
    }


def is_wrong(row: dict[str, Any]) -> bool:
    """True if a value of a measured file was off by more than the limit, or had a wrong sign."""
    return bool(row["checked"]["over_limit"] or row["checked"]["wrong_signs"])


def sentence(row: dict[str, Any]) -> str:
    """A line about one file."""
    name = row["mesh"]
    if "broken" in row or "stray_warnings" in row:
        return f"{name} BREAKS: {row.get('broken') or row['stray_warnings']}"
    if "refused" in row:
        return f"{name} refused: {row['refused']}"
    checked = row["checked"]
    kind = "closed" if row["closed"] else f"open, {row['boundary_edges']} boundary edges"
    advised = row.get("recommended_sign", row["sign"])
    advice = "" if advised == row["sign"] else f", {advised} recommended"
    verdict = f"  WRONG: {checked['over_limit']} values, {checked['wrong_signs']} signs" if is_wrong(row) else ""
    return (
        f"{name}: {row['triangles']} triangles, {row['components']} parts, {kind}, {row['sign']} "
        f"({row['ambiguous_voxels']} ambiguous{advice}), {checked['max_error'] or 0:.2f} roundings; first "
        f"{row['first_ms']:.3g} ms, repeated {row['repeated_ms']:.3g}, stock {row['stock_ms']:.3g}{verdict}"
    )


def _without(value: Any, folder: str) -> Any:
    if isinstance(value, str):
        return value.replace(folder, "")
    return [_without(part, folder) for part in value] if isinstance(value, list) else value


if __name__ == "__main__":
    sys.exit(main())
