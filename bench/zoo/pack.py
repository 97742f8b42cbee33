"""Meshes of a folder as one small archive of NumPy arrays, for a machine that has neither the files nor readers.

python -m sdm.bench.zoo.pack FOLDER zoo.tar.xz --most-mb 12
"""

from __future__ import annotations

import argparse
import io
import sys
import tarfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sdm.bench.common.meshes import Case
from sdm.bench.zoo.folder import meshes_of
from sdm.bench.zoo.speed import LEAST
from sdm.errors import SDMError
from sdm.io.files.atomic import replacing


def pack(cases: Sequence[Case], out: Path) -> int:
    """Write `NAME.npz` with `vertices` (V,3) float32 and `faces` (F,3) int32 for each mesh; the archive's bytes."""
    with replacing(out) as part, tarfile.open(part, "w:xz", preset=9) as archive:
        for case in cases:
            arrays = io.BytesIO()
            # Not compressed by itself: the archive's compression finds more in what is plain.
            np.savez(arrays, vertices=case.vertices, faces=case.faces)
            entry = tarfile.TarInfo(f"{case.name}.npz")
            entry.size = arrays.tell()
            arrays.seek(0)
            archive.addfile(entry, arrays)
    return out.stat().st_size


def main(argv: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="meshes in any format that sdm.load_mesh reads")
    parser.add_argument("out", type=Path, help="the archive, .tar.xz")
    parser.add_argument("--least", type=int, default=LEAST, help="triangles of the smallest mesh to take")
    parser.add_argument("--most-mb", type=float, default=float("inf"), help="the largest meshes are left out beyond it")
    given = parser.parse_args(argv)
    try:
        cases = sorted(meshes_of(given.folder, given.least), key=len)
        while (size := pack(cases, given.out)) > 1e6 * given.most_mb and cases:
            print(f"left out: {cases[-1].name}, {len(cases.pop()):,} triangles")
    except SDMError as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{len(cases)} meshes, {size / 1e6:.1f} MB: {given.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
