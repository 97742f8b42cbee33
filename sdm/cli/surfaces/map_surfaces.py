"""`sdm surface` over its maps: where meshes go, how each is made, and what is said about it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

from sdm.cli.common.inputs import refuse_twice
from sdm.cli.common.label_maps import LabelMaps, around_class, class_map, classes_of, labels_of, looks_like_labels
from sdm.cli.common.one_after_other import one_after_other
from sdm.cli.common.output_files import VOLUMES, inputs_of, places_in
from sdm.cli.common.printed_line import counted
from sdm.cli.common.progress import FileProgress
from sdm.core.given_values import as_level
from sdm.core.mesh import TriangleMesh
from sdm.core.signed_distance_map import SDM
from sdm.core.sparse_sdm import SparseSDM
from sdm.errors import FormatError, SDMError
from sdm.inspect.quick_look import look_at
from sdm.io import load
from sdm.io.files.stand_in import shown
from sdm.io.maps.formats import FORMATS, check_file
from sdm.io.meshes.write import WRITERS, ending_to_write, save_mesh

DEFAULT_ENDING = "ply"


def targets_of(maps: list[Path], out: Path, ending: str | None) -> list[tuple[Path, Path]]:
    """Pairs of a map and the mesh file to write, in a folder that is made.

    Raises:
        SDMError: No map at all.
        FormatError: Several meshes for one file, another format than that of the file, or a folder that cannot be made.
    """
    sources = inputs_of(maps, VOLUMES)
    if not sources:
        where = f"was found in {', '.join(map(str, maps))}" if maps else "was given"
        raise SDMError(f"no map {where}: name one or more files with .{', .'.join(FORMATS)}, or a folder of them")
    first = next(iter(sources))
    one = len(maps) == 1 and first == maps[0]
    if one and not first.exists():
        raise FormatError(f"there is no file {first}")
    if out.suffix.lower().removeprefix(".") in WRITERS and not out.is_dir():
        if not one:
            raise FormatError(f"several maps need a folder to write to, and {out} ends like one mesh")
        if ending not in (None, ending_to_write(out)):
            raise FormatError(f"{out} does not end with .{ending}, which --format asks for")
        check_file(out)
        jobs = [(first, out)]
    else:
        if one and out.suffix and not out.is_dir():
            ending_to_write(out)
        places = places_in(sources, VOLUMES)
        names = [out / place.with_name(f"{place.name}.{ending or DEFAULT_ENDING}") for place in places]
        jobs = list(zip(sources, names, strict=True))
        for folder in dict.fromkeys(target.parent for _, target in jobs):
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise FormatError(f"the folder {folder} cannot be made: {error.strerror or error}") from error
    return jobs


@dataclass(frozen=True, kw_only=True)
class MapSurfaces:
    """Meshes of maps, with options that are the same for all.

    Args:
        level: Of the surface, in the map's unit.
        labels: What is made of label volumes, and the device for all.
        flipped: Negate x and y.

    Raises:
        SDMError: The level is no number.
    """

    level: float
    labels: LabelMaps
    flipped: bool
    _written: list[Path] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        as_level(self.level)

    def run(self, jobs: list[tuple[Path, Path]], out: Path) -> int | None:
        """Write the mesh of each map, and say so, a line each; the exit code. One alone raises its error.

        Args:
            jobs: Pairs of a map and the mesh file to write.
            out: That file, if there is one alone; in a folder every mesh of a label has its class in its name.
        """

        def write(source: Path, target: Path, progress: FileProgress) -> None:
            self._write(source, target, target != out, progress)

        return one_after_other(jobs, "surfaces", write, "map", "maps")

    def _write(self, source: Path, target: Path, named: bool, progress: FileProgress) -> None:
        begin = time.perf_counter()
        found = load(source)
        if unknown := int(found.values.isnan().sum()):
            of_all = f"{unknown:,} of {counted(found.values.numel(), 'value')}"
            raise SDMError(f"{of_all} of {source} are not numbers (NaN), where no side is known: fill them in first")
        options = self.labels
        if isinstance(found, SparseSDM) or not self._has_labels(found):
            for option, given in (("--label", options.classes), ("--smooth", options.smooth)):
                if given is not None:
                    raise SDMError(f"{source} is a map and no label volume: {option} is for label volumes")
            self._write_one(found, f"{source}", target, begin, progress)
            return
        labels = labels_of(found, source)
        values = classes_of(labels, options.classes, source)
        # As far as a Gaussian is followed.
        reach = max(self.level, 0.0) + 4 * (options.smooth or 0.0)
        labels = labels.to(options.device)
        for value in values:
            begin, what = time.perf_counter(), f"{source}, class {value}"
            several = named or len(values) > 1
            own = target.with_name(f"{target.stem}_{value}{target.suffix}") if several else target
            mask, grid = around_class(labels == value, found.grid, reach)
            self._write_one(class_map(mask, value, grid, source, options), what, own, begin, progress)

    def _has_labels(self, found: SDM) -> bool:
        # A file that tells of its signs is a map of sdm's.
        if found.sign is not None:
            return False
        asked = self.labels.classes is not None or self.labels.smooth is not None
        return asked or (self.level == 0 and looks_like_labels(found.values))

    def _write_one(self, found: SDM | SparseSDM, what: str, target: Path, begin: float, progress: FileProgress) -> None:
        refuse_twice(target, self._written)
        check_file(target)
        try:
            mesh = found.to(self.labels.device).to_mesh(self.level)
        except SDMError as error:
            raise SDMError(f"{what}: {error}") from error
        if self.flipped:
            turned = mesh.vertices * mesh.vertices.new_tensor([-1.0, -1.0, 1.0])
            mesh = TriangleMesh(turned, mesh.faces, mesh.name, check=False)
        save_mesh(mesh, target)
        self._written.append(target)
        progress.print(
            f"{shown(what)}: {counted(len(mesh), 'triangle')}, "
            f"{time.perf_counter() - begin:.2f} s on {self.labels.device}, written to {shown(target)}"
        )
        if not look_at(mesh).is_closed(mesh):
            progress.print(
                f"sdm: {shown(what)}: the surface reaches the grid's border, and the mesh is open there; a voxel more "
                "on each side than the shape takes closes it",
                warn=True,
            )
