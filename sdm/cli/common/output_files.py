"""Output files of the meshes or volumes on a command line."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from sdm.errors import FormatError, MeshError
from sdm.io import FORMATS
from sdm.io.maps.volume_tree import is_volume_folder, placed_volumes
from sdm.io.meshes.mesh_tree import placed_meshes

DEFAULT_ENDING = "nii.gz"


@dataclass(frozen=True)
class Kind:
    """Kind of the files that are read: meshes or volumes.

    Args:
        one: Its name in sentences, and `many` of several.
        many: Several.
        file: What a file of it is called.
        placed: The files of a folder, each with its place below that folder.
        plain: A place without its ending.
        is_file: True of a folder that is one of them.
        written: Whether what is written is of this kind, too.
    """

    one: str
    many: str
    file: str
    placed: Callable[[Path], list[tuple[Path, Path]]]
    plain: Callable[[Path], Path]
    is_file: Callable[[Path], bool]
    written: bool


def _plain(place: Path) -> Path:
    return place.with_name(place.stem)


def _plain_volume(place: Path) -> Path:
    ending = next((known for known in FORMATS if place.name.lower().endswith(f".{known}")), None)
    return _plain(place) if ending is None else place.with_name(place.name[: -len(ending) - 1] or place.name)


MESHES = Kind("mesh", "meshes", "mesh file", placed_meshes, _plain, lambda _: False, written=False)
VOLUMES = Kind("label volume", "label volumes", "volume", placed_volumes, _plain_volume, is_volume_folder, written=True)


def plan(
    meshes: list[Path], out: Path, ending: str | None, default: str = DEFAULT_ENDING, *, kind: Kind = MESHES
) -> list[tuple[Path, Path]]:
    """Pairs of a mesh file and the map's file, in order.

    Args:
        meshes: Files, and folders whose mesh files are meant, also those of the folders in them.
        out: A file if it ends like a map, else a folder, which is made.
        ending: The format that was requested, without the dot.
        default: The format in a folder if none was.
        kind: Whether the sources are meshes or volumes.

    In a folder a map lies and is named as `places_in` says.

    Raises:
        MeshError: No mesh at all.
        FormatError: Several maps for one file, a format that is not that of the file, or a folder that cannot be made.
    """
    if not meshes:
        raise MeshError(f"no {kind.one} was given: name one or more {kind.file}s, or a folder of them")
    sources = inputs_of(meshes, kind)
    if kind.written:
        _refuse_own_folder(meshes, out, kind)
        sources = without_outputs(sources, meshes, out)
    if not sources:
        raise MeshError(f"no {kind.file} was found in {', '.join(map(str, meshes))}")
    one = len(meshes) == 1 and (not meshes[0].is_dir() or kind.is_file(meshes[0]))
    found = next((known for known in FORMATS if out.name.lower().endswith(f".{known}")), None)
    if found is not None and not (out.is_dir() and found != "zarr"):
        if not one:
            raise FormatError(f"several {kind.many} need a folder to write to, and {out} ends like one map")
        if ending not in (None, found):
            raise FormatError(f"{out} does not end with .{ending}, which --format asks for")
        return [(next(iter(sources)), out)]
    if one and out.suffix and not out.is_dir():
        raise FormatError(f"{out} does not end like a map: use one of .{', .'.join(FORMATS)}, or make the folder")
    places = places_in(sources, kind)
    targets = [out / place.with_name(f"{place.name}.{ending or default}") for place in places]
    for folder in dict.fromkeys([str(out), *map(os.path.dirname, targets)]):
        _make(Path(folder))
    return list(zip(sources, targets, strict=True))


def inputs_of(meshes: list[Path], kind: Kind = MESHES) -> dict[Path, Path]:
    """Mesh files, or volumes, each once, with their places: the path below the folder that was named, or the name."""
    found: dict[Path, Path] = {}

    @cache
    def true_folder(folder: Path) -> str:
        return os.path.realpath(folder)

    # A file may be named twice in different words: `a.ply` and `../here/a.ply`.
    known: set[tuple[str, str]] = set()
    for path in meshes:
        files = dict(kind.placed(path)) if path.is_dir() else {path: Path(path.name)}
        for file, place in files.items():
            if (where := (true_folder(file.parent), file.name)) not in known:
                known.add(where)
                found[file] = place
    return found


def without_outputs(sources: dict[Path, Path], named: list[Path], out: Path) -> dict[Path, Path]:
    """The sources but what a run before has written into a folder of what it read; files that were named stay."""
    place = os.path.realpath(out)
    if not any(place.startswith(f"{os.path.realpath(path)}{os.sep}") for path in named):
        return sources
    real = {folder: os.path.realpath(folder) for folder in {file.parent for file in sources}}
    own = {folder for folder, there in real.items() if f"{there}{os.sep}".startswith(f"{place}{os.sep}")}
    return {file: name for file, name in sources.items() if file in named or file.parent not in own}


def _refuse_own_folder(named: list[Path], out: Path, kind: Kind) -> None:
    if any(path.is_dir() and not kind.is_file(path) and path.resolve() == out.resolve() for path in named):
        raise FormatError(f"{out} is the folder of the {kind.many}: name another one for what is written")


def places_in(sources: dict[Path, Path], kind: Kind = MESHES) -> list[Path]:
    """Places of outputs in a folder, as paths without an ending, no two alike.

    Each lies like its source below the folder that was named. Where that makes two alike, as of two folders or of files
    called alike, all lie as their sources do below the folder that is common to them. Sources that then differ by their
    endings alone keep these.
    """
    places = list(sources.values())
    plain = [kind.plain(place) for place in places]
    if len(set(plain)) < len(places) and len(set(places)) < len(places):
        whole = [source.parent.resolve() / source.name for source in sources]
        common = os.path.commonpath([path.parent for path in whole])
        places = [path.relative_to(common) for path in whole]
        plain = [kind.plain(place) for place in places]
    times = Counter(plain)
    names = [short if times[short] == 1 else place for short, place in zip(plain, places, strict=True)]
    # One without its ending may be called as another one with it: `a.ply.ply` beside `a.ply` and `a.stl`.
    while len(set(names)) < len(set(places)):
        times = Counter(names)
        names = [name if times[name] == 1 else place for name, place in zip(names, places, strict=True)]
    return names


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
    except FileExistsError as error:
        raise FormatError(
            f"{folder} is a file, and its name does not end like a map: name a folder, or a file with one of "
            f".{', .'.join(FORMATS)}"
        ) from error
    except OSError as error:
        raise FormatError(f"the folder {folder} cannot be made: {error.strerror or error}") from error
