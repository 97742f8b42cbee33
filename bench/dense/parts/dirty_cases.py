"""Dirty meshes to measure maps of: torn, opened, turned, loose ones by code, and real ones where their files are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import sdm
from sdm.bench.common.dirty_meshes.by_code import boxes, doubled, half_spheres, loose, sheets, torn, turned
from sdm.bench.common.mesh_formulas import Arrays, joined, moved, sphere
from sdm.bench.common.meshes import Case, load_case, missing_note

TORUS = "torus-20000"
TORN, SPHERES = (0.01, 0.03, 0.1, 0.3), (10, 100, 500)
# Meshes of files, which are left out where they are not found: of the data by name, of a folder of foreign meshes by
# the beginning of a path in it.
KNOWN = ("rocker-arm", "nefertiti")
REAL = ("stanford-bunny", "chair_model", "beetle", "cycloidal", "featuretype")
FOREIGN = ("b9_mesh", "boeing", "pig.", "elephant-with-holes", "oblong-shuffled", "2CylinderEngine")
OPEN = frozenset(("open",))


def made(name: str, mesh: Arrays) -> Case:
    """A dirty mesh made here."""
    return Case(name, *mesh, OPEN)


def variants(clean: Case, shares: Sequence[float] = TORN) -> Iterator[Case]:
    """A mesh without shares of its faces."""
    for share in shares:
        yield made(f"{clean.name} less {100 * share:.0f} %", torn((clean.vertices, clean.faces), share))


def generated() -> Iterator[Case]:
    """Dirty meshes by code, after the clean one that some are made of."""
    clean = load_case(TORUS)
    arrays = clean.vertices, clean.faces
    yield clean
    yield from variants(clean)
    yield made(f"{TORUS}, half its faces turned", turned(arrays, 0.5))
    for count in SPHERES:
        yield made(f"{count} half spheres", half_spheres(count))
    yield made("60 sheets", sheets(60))
    yield made("300 open boxes", boxes(300))
    yield made("doubled walls less 3 %", torn(doubled(sphere(70), 0.01), 0.03))
    yield made("crossing parts less 3 %", torn(joined(arrays, moved(arrays, 0.9, (0.4, 0.3, 0.1))), 0.03))
    yield made("shuffled faces, gaps between", loose(arrays, 0.002))


def of_files(folder: Path | None) -> Iterator[Case]:
    """Real meshes that are found: torn, or dirty as they are."""
    for name in KNOWN:
        if missing_note(name) is None:
            yield from variants(load_case(name))
    for name in REAL:
        if missing_note(name) is None:
            yield load_case(name)
    if folder is not None:
        for beginning in FOREIGN:
            for path in sorted(folder.rglob(f"{beginning}*")):
                if path.suffix in (".npz", ".off", ".stl", ".glb"):
                    mesh = mesh_of(path)
                    yield Case(path.stem, mesh.vertices.numpy(), mesh.faces.numpy(), OPEN)
                    break


def mesh_of(path: Path) -> sdm.TriangleMesh:
    """A mesh of a file, or of an archive with `vertices` and `faces`."""
    if path.suffix != ".npz":
        return sdm.load_mesh(path)
    arrays = np.load(path)
    return sdm.TriangleMesh(arrays["vertices"], arrays["faces"])
