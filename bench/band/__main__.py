"""Narrow bands: seconds and memory against resolution, ours and OpenVDB's, each with its errors beside it.

    python -m sdm.bench.band --device cpu --out band-cpu.json

For each mesh and resolution (voxels along the longest axis of a cube around it) the band of `--half-width` voxels is
made `--runs` times by turns: by `sdm.narrow_band` from vertices and faces in new memory, structure and signs included,
and by OpenVDB's `meshToLevelSet` (see `sdm.bench.peers.openvdb`), on as many cores. On a GPU also by Newton's
`Mesh.build_sdf` (see `sdm.bench.peers.newton`), by PhysicsNeMo's `signed_distance_field` and by MeshLib's CUDA searches
for closest points and winding numbers, where they are installed; these two are told for nothing which voxels are in
the band, and `query` of MeshLib's rows leaves out the build of its structures. `seconds` are medians, `cpu` those of
all cores together: on a machine that others use too, only these compare. Before that all are compared with a float64
brute force at `--samples` voxels of the band: `error` is the largest, in voxels, `signs` how many are on the wrong
side. `peak` is what a process that makes one band has more in memory than before it, `bytes` what the band itself
takes.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import torch

from sdm.bench.band.figures import draw
from sdm.bench.band.job import measure
from sdm.bench.band.peer_rows import OTHERS, notes
from sdm.bench.common import json_file
from sdm.bench.common.machine import describe
from sdm.bench.common.meshes import load_case, missing_note
from sdm.bench.peers import openvdb

MESHES = ("fandisk", "rocker-arm", "nefertiti", "torus-1000000")
RESOLUTIONS = (256, 512, 1024)


def line(name: str, resolution: int, found: dict[str, Any]) -> str:
    """One line of the table that is printed."""
    return (
        f"{name:16}{resolution:>6}^3  {found['library']:8}{found['seconds']:>9.3f}{found['cpu']:>9.3f}"
        f"{found['error']:>11.2e}{found['signs']:>7}{found['active_voxels']:>13,}"
        f"{found['bytes'] / 2**20:>9.1f}{found['peak'] / 2**20:>9.1f}"
    )


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--meshes", nargs="*", default=list(MESHES), help="names, torus-N, or files")
    parser.add_argument("--resolutions", type=int, nargs="*", default=list(RESOLUTIONS))
    parser.add_argument("--half-width", type=float, default=3.0)
    parser.add_argument("--samples", type=int, default=2000, help="voxels of the band that are compared")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--alone", action="store_true", help="without other libraries")
    parser.add_argument("--add", action="store_true", help="keep the other rows of the file that is there")
    parser.add_argument("--out", type=Path, help="a JSON file; a picture goes beside it")
    given = parser.parse_args()
    note = "OpenVDB was not asked for" if given.alone else openvdb.missing()
    others = {name: f"{name} was not asked for" for name in OTHERS} if given.alone else notes(given.device)
    for sentence in (note, *others.values()):
        if sentence:
            print(sentence)
    print(
        f"{'':36}{'seconds':>5}{'cpu':>9}{'error':>11}{'signs':>7}{'active voxels':>13}{'MiB':>9}{'peak':>9}",
        flush=True,
    )
    rows = json.loads(given.out.read_text())["rows"] if given.add else []
    for name in given.meshes:
        if (why := missing_note(name)) is not None:
            print(why)
            continue
        case = load_case(name)
        for resolution in given.resolutions:
            found = measure(
                case,
                given.device,
                resolution,
                given.half_width,
                given.samples,
                given.runs,
                with_peer=note is None,
                others=[name for name, why in others.items() if why is None],
            )
            for one in found:
                print(line(name, resolution, one), flush=True)
            rows = [row for row in rows if (row["mesh"], row["resolution"]) != (case.name, resolution)] + found
            if given.out:
                report = {"machine": describe(given.device), "half_width": given.half_width, "note": note, "rows": rows}
                report |= {f"note_on_{name.lower()}": why for name, why in others.items()}
                json_file.write(given.out, report)
    if given.out and rows:
        draw(json.loads(given.out.read_text()), given.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
