"""`sdm sample` over its meshes: names, recipe, what is said about each mesh, and the report."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from sdm.cli.common.output_files import inputs_of, places_in
from sdm.cli.common.printed_line import print_line
from sdm.cli.common.progress import FileProgress
from sdm.cli.maps.mesh_report import MeshEntry, write_report
from sdm.cli.maps.run import sum_up
from sdm.cli.maps.sample_job import SampleJob, entry_of
from sdm.cli.maps.sample_journal import SampleJournal
from sdm.core.device import choose_device
from sdm.core.normalization import Normal
from sdm.engine.arguments import Orient, Sign, SignMethod
from sdm.errors import FormatError, MeshError, SDMError
from sdm.io.files.leftovers import remove_leftovers
from sdm.io.files.lock import alone
from sdm.io.files.stand_in import known as stand_ins
from sdm.io.files.stand_in import shown
from sdm.io.meshes.split_file import files_of_part, read_split
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.process_count import processes_for
from sdm.runtime.sharing.share_out import shard_size, share_out
from sdm.sampling.law import PAPER, RELEASED, SampleLaw
from sdm.sampling.layouts.by_name import layout_called
from sdm.sampling.layouts.instance import Instance, instances_of
from sdm.sampling.layouts.sample_layout import Layout
from sdm.sampling.recipe import Recipe
from sdm.sampling.sample import require_room
from sdm.sampling.sample_folder import FolderSampling

REPORT = "report.json"
# About what one process of an H100's host takes.
SECONDS_OF_A_SAMPLE = 2e-8
# Layouts with lists of a name a line.
BY_LINES = ("occupancy", "webdataset")
LAWS = {"paper": PAPER, "released": RELEASED}


@dataclass(frozen=True, kw_only=True)
class SampleOptions:
    """Options of `sdm sample`; None where the law or the layout says."""

    law: str | None
    shares: tuple[int | None, int | None, int | None]
    deviations: tuple[float, ...] | None
    box: float | None
    normalize: str | None
    count: int | None
    closest: bool
    sign: Sign
    hole_size: float | None
    open_meshes: str | None
    seed: int
    orient: Orient = "auto"

    def recipe(self, name: str, layout: Layout) -> Recipe:
        """All that samples depend on, for a layout."""
        SignMethod(self.sign, self.hole_size)
        count = layout.count if self.count is None else self.count
        if count < 1:
            raise SDMError(f"--count is {count}; give 1 or more samples")
        if name == "occupancy" and self.sign == "none":
            raise SDMError("the layout occupancy tells what is inside, and --sign none does not")
        if self.closest and name != "webdataset":
            raise SDMError(f"the layout {name} has no place for closest points: use --layout webdataset")
        if self.law is not None and name == "occupancy":
            raise SDMError(
                "the layout occupancy has a law of its own: leave out --law, or change it by --near and others"
            )
        if self.open_meshes == "reject" and self.sign != "winding":
            raise SDMError(f"--sign {self.sign} takes meshes with holes, and --open-meshes is for --sign winding")
        normal = layout.normalize if self.normalize is None else self.normalize
        kinds: dict[str, Normal | None] = {"sphere": "sphere", "cube": "cube", "none": None}
        return Recipe(
            layout=name,
            law=self._law(layout.law if name == "occupancy" else LAWS[self.law or "paper"]),
            count=count,
            normalize=kinds[normal],
            seed=self.seed,
            sign=self.sign,
            hole_size=self.hole_size,
            closest=self.closest,
            open_meshes=self.open_meshes or "reject",
            orient=self.orient,
        )

    def _law(self, law: SampleLaw) -> SampleLaw:
        given = dict(zip(("near", "uniform", "surface"), self.shares, strict=True))
        shares = {name: getattr(law, name) if value is None else value for name, value in given.items()}
        for option, value, kind, where in (
            ("--deviations", self.deviations, "near", "near the surface"),
            ("--box", self.box, "uniform", "in the box"),
        ):
            if value is not None and shares[kind] == 0:
                raise SDMError(f"{option} is of samples {where}, of which this law has none: give --{kind} too")
        return replace(
            law,
            **shares,
            deviations=law.deviations if self.deviations is None else self.deviations,
            box=law.box if self.box is None else self.box,
        )


def run(
    meshes: list[Path],
    out: Path,
    layout_name: str,
    options: SampleOptions,
    *,
    dataset: str | None = None,
    split: str | None = None,
    device: str = "auto",
    resume: bool = False,
    skip_bad: bool = False,
    workers: int | None = None,
    times: StageTimes | None = None,
    devices: list[str] | None = None,
    ray: str | None = None,
) -> int | None:
    """Sample each mesh into the folder; 2 if some failed and are not to be skipped.

    `devices` of this machine share the meshes if there are many, or those of the Ray cluster at `ray` do.
    """
    chosen = _chosen(meshes, dataset, split)
    if out.exists() and not out.is_dir():
        raise FormatError(f"{shown(out)} is a file: name a folder for the samples")
    odd = next((own.path for own in chosen.instances if "\n" in own.path), None)
    if layout_name in BY_LINES and odd is not None:
        raise FormatError(f"the layout {layout_name} lists meshes line by line, and {odd!r} has two lines: rename it")
    layout = layout_called(layout_name, chosen.dataset)
    recipe, where = options.recipe(layout_name, layout), choose_device(device)
    require_room(recipe.count, where)
    seconds = len(chosen.sources) * recipe.count * SECONDS_OF_A_SAMPLE
    processes = [str(where)] if devices is None else processes_for(devices, seconds)
    times = StageTimes() if times is None else times
    try:
        out.mkdir(parents=True, exist_ok=True)
        # Of two at a time the recipe would be that of one, and samples those of both.
        with alone(out):
            recipe.claim(out, [instance.path for instance in chosen.instances], chosen.parts, resume=resume)
            by = {"ray": ray, "resume": resume, "workers": workers}
            entries = _sample(chosen, out, layout, recipe, where, processes, times, **by)
    except OSError as error:
        raise FormatError(f"{out} cannot be written: {error.strerror or error}; --resume goes on from there") from error
    done = sum(entry.state != "failed" for entry in entries)
    whose = f"each of {done:,} meshes" if done > 1 else "one mesh" if done else "no mesh"
    print_line(f"{shown(out)}: {recipe.count:,} samples of {whose}, layout {layout_name}")
    return sum_up(entries, skip_bad)


def _sample(
    chosen: _Chosen,
    out: Path,
    layout: Layout,
    recipe: Recipe,
    where: torch.device,
    processes: list[str],
    times: StageTimes,
    *,
    ray: str | None,
    resume: bool,
    workers: int | None,
) -> list[MeshEntry]:
    """Sample each mesh into a folder of this recipe; what there is to say about them, in order."""
    sources, instances = chosen.sources, chosen.instances
    journal = SampleJournal(out, out / REPORT, len(sources), resume=resume)
    known = journal.known
    sampling = FolderSampling(
        sources, instances, out, layout, recipe, where, parts=chosen.parts, known=known, workers=workers, times=times
    )
    entries: list[MeshEntry] = []
    with journal, FileProgress(len(sources), times) as progress:
        progress.begin(sources[0].name)

        def hear(told: Iterable[MeshEntry]) -> None:
            for entry in told:
                entries.append(journal.told(len(entries), entry))
                progress.end()
                if len(entries) < len(sources):
                    progress.begin(sources[len(entries)].name)

        if ray is None and len(processes) < 2:
            found_of = sampling.some(range(len(sources)))
            hear(entry_of(outcome, sources[number], recipe.sign) for number, outcome in found_of)
        else:
            size = shard_size(len(sources), 0 if ray is not None else len(processes))
            job = SampleJob(
                wanted=list(range(len(sources))),
                each=-(-size // layout.together) * layout.together,
                sources=sources,
                instances=instances,
                out=out,
                dataset=chosen.dataset,
                recipe=recipe,
                workers=workers,
                known=known,
                stand_ins=stand_ins(),
            )
            share_out(job, job.shards, processes, ray, hear, times)
        sampling.end([entry.state != "failed" for entry in entries])
        if resume:
            remove_leftovers(out)
        write_report(entries, out / REPORT, seconds_of_stages=times.seconds)
    return entries


@dataclass(frozen=True, kw_only=True)
class _Chosen:
    """The meshes to sample, and their names.

    Args:
        sources: Their files.
        instances: Their names in a dataset.
        parts: The numbers that each part of the folder's split has.
        dataset: The dataset's name.
    """

    sources: list[Path]
    instances: list[Instance]
    parts: dict[str, list[int]]
    dataset: str


def _chosen(meshes: list[Path], dataset: str | None, part: str | None) -> _Chosen:
    """The meshes of a folder's part, or all.

    Raises:
        FormatError: The lists of a split cannot be read.
        MeshError: There are none.
        SDMError: The dataset's name is no name of a folder.
    """
    found = inputs_of(meshes)
    if not found:
        where = f"was found in {', '.join(map(str, meshes))}" if meshes else "was given"
        raise MeshError(f"no mesh {where}: name one or more mesh files, or a folder of them")
    if dataset is not None and (Path(dataset).name != dataset or dataset == ".."):
        raise SDMError(f"--dataset {dataset} is no name of a folder: give one without {os.sep}")
    if part is not None and not (len(meshes) == 1 and meshes[0].is_dir()):
        raise MeshError("--split takes a part of one folder of meshes, which sdm split has split: name that folder")
    files, instances = list(found), instances_of(places_in(found))
    lists = _lists_of(meshes[0], required=part is not None) if len(meshes) == 1 else {}
    if part is not None:
        kept = files_of_part(meshes[0], part, files)
        if not kept:
            raise MeshError(f"the part {part!r} of {meshes[0]} has no mesh")
        by_file = dict(zip(files, instances, strict=True))
        files, instances, lists = kept, [by_file[file] for file in kept], {part: lists[part]}
    number = {found[file].as_posix(): n for n, file in enumerate(files)}
    roots = [path for path in meshes if path.is_dir()]
    return _Chosen(
        sources=files,
        instances=instances,
        parts={name: [number[path] for path in own if path in number] for name, own in lists.items()},
        dataset=dataset or (roots[0].resolve().name if roots else "meshes"),
    )


def _lists_of(source: Path, *, required: bool) -> dict[str, list[str]]:
    """The parts of a folder's split; none if it has none, and of a file."""
    try:
        return read_split(source) if source.is_dir() else {}
    except FormatError:
        # A file of that name may be somebody else's.
        if required:
            raise
        return {}
