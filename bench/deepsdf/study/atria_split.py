"""Near twins among the left atria, and the split of the studies, which keeps them together.

    python -m sdm.bench.deepsdf.study.atria_split --data ../shared/data     # minutes on a CPU
    python -m sdm.bench.deepsdf.study.atria_split --show                     # the table of the record

All 80 labels are laid on each other in pairs. Shapes nearer than `LIMIT_MM` are twins, and twins of twins one
group; a group is dealt whole to training, validation or test, in an order drawn from a seed. The record holds names and
distances alone, so machines without the data have the same split.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

import torch

from sdm.bench.common.checkout import data_folder, results_folder
from sdm.bench.common.json_file import put
from sdm.bench.common.machine import describe
from sdm.bench.deepsdf.shapes import Shapes, atria
from sdm.bench.deepsdf.tables import rows_table
from sdm.core.mesh import TriangleMesh
from sdm.errors import FormatError
from sdm.sampling.near_twins import distances_between, near_twins, split_groups

RECORD = results_folder() / "near_twins.json"
# Two voxels of 0.625 mm. There is no gap in the distances between twins and others; half of all pairs are 2.9 apart.
LIMIT_MM = 1.3
TEST, VALIDATION, SEED = 16, 8, 2026


def groups_of(record: dict[str, Any]) -> list[list[str]]:
    """Names of the shapes of each group of near twins; of shapes that are the same, the first alone."""
    names, matrix = record["names"], torch.tensor(record["distances_mm"], dtype=torch.float64)
    same = duplicates_of(record)
    return [[names[n] for n in group if names[n] not in same] for group in near_twins(matrix, record["limit_mm"])]


def split_of(record: dict[str, Any]) -> dict[str, list[str]]:
    """Names of the shapes to train on, to choose settings by, and to report."""
    return split_groups(groups_of(record), {"test": TEST, "validation": VALIDATION}, "training", seed=SEED)


def read_record(path: Path = RECORD) -> dict[str, Any]:
    """The record of the distances.

    Raises:
        FormatError: There is none.
    """
    if not path.is_file():
        raise FormatError(f"{path} is not there: make it by python -m sdm.bench.deepsdf.study.atria_split")
    return json.loads(path.read_text())


def split_atria(found: Shapes, record: dict[str, Any]) -> dict[str, list[TriangleMesh]]:
    """Meshes of each part."""
    meshes = {mesh.name: mesh for mesh in (*found.training, *found.test)}
    if missing := sorted(set(record["names"]) - set(meshes)):
        raise FormatError(f"the data lack {len(missing)} of the record's shapes, the first {missing[0]}")
    return {part: [meshes[name] for name in names] for part, names in split_of(record).items()}


def duplicates_of(record: dict[str, Any], within_mm: float = 0.05) -> list[str]:
    """Names of shapes that are one before them in the record once more, as 0RZD is CMPX but for the volume's cut."""
    names, matrix = record["names"], record["distances_mm"]
    return [names[j] for j in range(len(names)) if any(matrix[i][j] < within_mm for i in range(j))]


def twins_of(record: dict[str, Any], names: Collection[str]) -> set[str]:
    """Names of the other shapes that are near twins of these, or twins of such twins, or the same."""
    numbers = near_twins(torch.tensor(record["distances_mm"], dtype=torch.float64), record["limit_mm"])
    groups = [{record["names"][n] for n in group} for group in numbers]
    return {name for group in groups if group & set(names) for name in group} - set(names)


def table_of(record: dict[str, Any]) -> str:
    """Pairs of near twins, nearest first, and the next ones beyond the limit."""
    names, matrix, parts = record["names"], record["distances_mm"], split_of(record)
    where = {name: part for part, own in parts.items() for name in own} | dict.fromkeys(duplicates_of(record), "none")
    pairs = sorted((matrix[i][j], i, j) for j in range(len(names)) for i in range(j))
    twins = sum(d < record["limit_mm"] for d, *_ in pairs)
    rows = [
        {"pair": f"{names[i][:4]}, {names[j][:4]}", "mm": round(d, 3), "old": f"{_old(i)}, {_old(j)}",
         "new": f"{where[names[i]]}, {where[names[j]]}", "twins": "yes" if n < twins else "no"}
        for n, (d, i, j) in enumerate(pairs[: twins + 5])
    ]  # fmt: skip
    middle = pairs[len(pairs) // 2][0]
    head = (
        f"{len(names)} shapes, {twins} pairs nearer than {record['limit_mm']} mm (the median pair {middle:.2f} mm); "
        + ", ".join(f"{len(own)} {part}" for part, own in parts.items())
    )
    columns = {"pair": "pair", "mm": "distance [mm]", "twins": "twins", "old": "sides before", "new": "sides now"}
    return "\n".join([head, "", *rows_table(rows, columns)])


def _old(number: int) -> str:
    """The side of a shape in the data's own folders: the record lists the 72 of `train` and `labels` first."""
    return "training" if number < 72 else "test"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder(), help="data folder, or the packed file")
    parser.add_argument("--cache", type=Path, help="file that keeps the surfaces of the atria")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--out", type=Path, default=RECORD)
    parser.add_argument("--show", action="store_true", help="the table of the record, and nothing else")
    options = parser.parse_args()
    if not options.show:
        found = atria(options.data, cache=options.cache)
        meshes = [*found.training, *found.test]
        matrix = distances_between(meshes, options.device)
        record = {
            "machine": describe(options.device),
            "names": [m.name for m in meshes],
            "limit_mm": LIMIT_MM,
        }
        # A row of distances a line.
        rows = ",\n".join(json.dumps([round(value, 4) for value in row]) for row in matrix.tolist())
        put(options.out, f'{json.dumps(record, indent=1)[:-2]},\n "distances_mm": [\n{rows}\n ]\n}}\n')
    print(table_of(read_record(options.out)))


if __name__ == "__main__":
    main()
