"""Output files of the meshes on a command line."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from sdm.errors import FormatError, MeshError
from sdm.io import FORMATS, mesh_files

DEFAULT_ENDING = "nii.gz"


def plan(meshes: list[Path], out: Path, ending: str | None) -> list[tuple[Path, Path]]:
    """Pairs of a mesh file and the map's file, in order.

    Args:
        meshes: Files, and folders whose mesh files are meant.
        out: A file if it ends like a map, else a folder, which is made.
        ending: The format that was requested, without the dot.

    In a folder a map is named like its mesh; where two meshes differ by their ending alone, it stays in the name.

    Raises:
        MeshError: No mesh at all.
        FormatError: Several maps for one file, a format that is not that of the file, or a folder that cannot be made.
    """
    if not meshes:
        raise MeshError("no mesh was given: name one or more mesh files, or a folder of them")
    # A file that is named twice is computed once.
    sources = list(dict.fromkeys(file for path in meshes for file in (mesh_files(path) if path.is_dir() else [path])))
    if not sources:
        raise MeshError(f"no mesh file was found in {', '.join(map(str, meshes))}")
    one = len(meshes) == 1 and not meshes[0].is_dir()
    found = next((known for known in FORMATS if out.name.lower().endswith(f".{known}")), None)
    if found is not None and not (out.is_dir() and found != "zarr"):
        if not one:
            raise FormatError(f"several meshes need a folder to write to, and {out} ends like one map")
        if ending not in (None, found):
            raise FormatError(f"{out} does not end with .{ending}, which --format asks for")
        return [(sources[0], out)]
    if one and out.suffix and not out.is_dir():
        raise FormatError(f"{out} does not end like a map: use one of .{', .'.join(FORMATS)}, or make the folder")
    targets = targets_in(out, sources, ending or DEFAULT_ENDING)
    _make(out)
    return list(zip(sources, targets, strict=True))


def targets_in(out: Path, sources: list[Path], ending: str) -> list[Path]:
    """A file of a folder for each source, named like it; sources that differ by their ending alone keep it.

    Raises:
        FormatError: Two sources have one name.
    """
    times = Counter(source.stem for source in sources)
    names = [source.stem if times[source.stem] == 1 else source.name for source in sources]
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise FormatError(
            f"several files are called {twice}, and so would be what is written: give them one at a time, each with a "
            "name of its own to write to"
        )
    return [out / f"{name}.{ending}" for name in names]


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(f"the folder {folder} cannot be made: {error.strerror or error}") from error
