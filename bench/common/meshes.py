"""The labelled meshes that tests, benchmarks and the accuracy report share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sdm.bench.common import degenerate_meshes as nasty
from sdm.bench.common.checkout import data_folder
from sdm.bench.common.dirty_meshes.by_code import DIRTY
from sdm.bench.common.mesh_formulas import Arrays, cube, hemisphere, inverted, joined, moebius, moved, sphere, torus

__all__ = ["Case", "cube", "dirty_names", "generated_names", "load_case", "missing_note", "names", "sphere", "torus"]


@dataclass(frozen=True, eq=False)
class Case:
    """A labelled mesh: vertices (V,3) float32, faces (F,3) int32, and what it is like.

    Tags: `closed` (the winding number is a whole number), `open` (it has borders), `soup` (no inside meant),
    `real` or `generated`, `sliver`, `degenerate` (zero-area or repeated faces), `inverted`, `far` (coordinates much
    larger than the mesh), `scaled`, `smooth` (clean: every library should manage it).
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    tags: frozenset[str]

    def __len__(self) -> int:
        return len(self.faces)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of what the faces use, float64."""
        used = self.vertices[self.faces.reshape(-1)].astype(np.float64)
        return used.min(0), used.max(0)


_MAKERS: dict[str, tuple[Callable[[], Arrays], str]] = {
    "cube": (cube, "closed smooth"),
    "sphere": (sphere, "closed smooth"),
    "torus": (torus, "closed smooth"),
    "nested shells": (lambda: joined(sphere(20), moved(sphere(16), 0.6), moved(cube(), 0.2)), "closed"),
    "hollow sphere": (lambda: joined(sphere(20), inverted(moved(sphere(16), 0.6))), "closed"),
    "touching cubes": (
        lambda: joined(cube(), moved(cube(), offset=(2, 0, 0)), moved(cube(), offset=(0, 2, 2))),
        "closed",
    ),
    "overlapping shells": (lambda: joined(sphere(20), moved(torus(2048), 1.2, (0.7, 0, 0.1))), "closed"),
    "inverted sphere": (lambda: inverted(sphere(20)), "closed inverted"),
    "coincident shells": (lambda: joined(sphere(20), sphere(20)), "closed degenerate"),
    "cancelling shells": (lambda: joined(sphere(20), inverted(sphere(20))), "closed degenerate"),
    "open hemisphere": (hemisphere, "open"),
    "moebius strip": (moebius, "open soup"),
    "single triangle": (lambda: (sphere(3)[0][:3], np.array([[0, 1, 2]], np.int32)), "open soup"),
    "t-junctions": (nasty.t_junctions, "open"),
    "filled t-junctions": (nasty.filled_t_junctions, "closed sliver"),
    "three sheets": (nasty.three_sheets, "open"),
    "needle box": (nasty.needle_box, "closed sliver"),
    "needle fan": (nasty.needle_fan, "closed sliver"),
    "loose slivers": (nasty.sliver_sphere, "open sliver"),
    "unmerged sphere": (nasty.unmerged_sphere, "closed"),
    "zero-area faces": (nasty.zero_area_faces, "closed degenerate sliver"),
    "repeated faces": (nasty.repeated_faces, "open degenerate"),
    "collinear soup": (nasty.collinear_soup, "soup degenerate"),
    "thin soups": (nasty.thin_soups, "soup sliver"),
    "random soup": (nasty.random_soup, "soup"),
    "repeated-vertex soup": (nasty.repeated_vertex_soup, "soup degenerate"),
    "far from the origin": (lambda: moved(torus(), offset=(1e4, -1.7e4, 0.6e4)), "closed far"),
    "scaled by 1e20": (lambda: moved(torus(), 1e20), "closed scaled"),
    "scaled by 1e-20": (lambda: moved(torus(), 1e-20), "closed scaled"),
    "tiny beside huge": (nasty.tiny_beside_huge, "closed"),
}
_REAL = {
    "nefertiti": "closed smooth",
    "rocker-arm": "closed smooth",
    "fandisk": "closed smooth",
    "spot": "closed smooth",
    "stanford-bunny": "open",
    "beast": "open",
    "ogre": "open degenerate",
    "beetle": "open",
    "featuretype": "open",
    "cycloidal": "open",
    "chair_model": "open soup",
    "soup": "soup",
}
SCALA = "scala tympani"


def generated_names() -> list[str]:
    """The meshes that need no files."""
    return list(_MAKERS)


def dirty_names() -> list[str]:
    """Dirty meshes that need no files; `names` leaves them out."""
    return list(DIRTY)


def names(tags: Iterable[str] = (), *, without: Iterable[str] = ()) -> list[str]:
    """All known meshes with every one of `tags` and none of `without`, whether their files are here or not."""
    wanted, unwanted = set(tags), set(without)
    return [n for n, t in _all_tags().items() if wanted <= t and not unwanted & t]


def missing_note(name: str) -> str | None:
    """Why a mesh cannot be loaded, as a sentence; None if it can."""
    path = _path(name)
    if path is None or path.is_file():
        return None
    return f"{name} is left out: there is no {path.name} in {path.parent}; set SDM_DATA to the folder of the data"


def load_case(name: str) -> Case:
    """A mesh by its name; `torus-N` is a torus of about N triangles, and a path is a user's own file.

    Raises:
        FileNotFoundError: Its file is not here; see `missing_note`.
        KeyError: No such mesh.
    """
    note = missing_note(name)
    if note is not None:
        raise FileNotFoundError(note)
    tags = _all_tags().get(name, frozenset())
    path = _path(name)
    if path is not None:
        return Case(name, *_read(path), tags)
    if name in _MAKERS:
        return Case(name, *_MAKERS[name][0](), tags)
    if name in DIRTY:
        make, kinds = DIRTY[name]
        return Case(name, *make(), frozenset(kinds.split()) | {"generated"})
    if name.startswith("torus-") and name[6:].isdigit() and int(name[6:]) > 0:
        return Case(name, *torus(int(name[6:])), frozenset(("closed", "smooth", "generated")))
    if Path(name).is_file():
        return Case(Path(name).stem, *_read(Path(name)), frozenset(("own",)))
    raise KeyError(f"there is no mesh called {name!r}, and no such file; give a file, torus-N or a name of {__name__}")


def _all_tags() -> dict[str, frozenset[str]]:
    tags = {n: frozenset((*t.split(), "real")) for n, t in (*_REAL.items(), (SCALA, "closed smooth"))}
    return tags | {n: frozenset((*t.split(), "generated")) for n, (_, t) in _MAKERS.items()}


def _path(name: str) -> Path | None:
    if name == SCALA:
        return data_folder() / "scala_tympani" / "scala_tympani_mean.ply"
    return data_folder() / "meshes" / f"{name}.ply" if name in _REAL else None


def _read(path: Path) -> Arrays:
    import trimesh

    mesh = trimesh.load_mesh(path, process=False)
    return np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
