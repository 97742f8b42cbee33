"""Samples of some of a folder's meshes: in this process, or a shard of what several devices do."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from sdm.cli.common.failed_item import reason_of
from sdm.cli.common.printed_line import counted
from sdm.cli.maps.mesh_report import MeshEntry
from sdm.core.device import choose_device
from sdm.engine.arguments import Sign
from sdm.io.files.stand_in import StandIn, adopt, shown
from sdm.runtime.pipeline.outcome import Done, Failed
from sdm.runtime.pipeline.stage_times import StageTimes
from sdm.runtime.sharing.folder_job import FolderJob, ShardTold, require_seen
from sdm.sampling.layouts.by_name import layout_called
from sdm.sampling.layouts.instance import Instance
from sdm.sampling.recipe import Recipe
from sdm.sampling.sample_folder import FolderSampling, SampledMesh


@dataclass(frozen=True, eq=False, kw_only=True)
class SampleJob(FolderJob):
    """Samples of many meshes in shards, for several processes.

    Args:
        sources: Mesh files.
        instances: Their names in the dataset.
        out: The folder.
        dataset: Name of the dataset.
        recipe: What is sampled, and the layout's name.
        known: Numbers of meshes that need not be read if their samples are there.
        workers: Threads that read, and as many that write; by default what the machine has.
        stand_ins: Paths that stand for addresses.
    """

    sources: list[Path]
    instances: list[Instance]
    out: Path
    dataset: str
    recipe: Recipe
    known: frozenset[int] = frozenset()
    workers: int | None = None
    stand_ins: tuple[StandIn, ...] = ()

    def absolute(self) -> SampleJob:
        """See `SharedJob`."""
        return replace(self, sources=[source.absolute() for source in self.sources], out=self.out.absolute())

    def check(self) -> None:
        """See `SharedJob`."""
        require_seen(self.sources[self.wanted[0]], self.out)

    def maker(self, device: str) -> FolderSampling:
        """See `SharedJob`."""
        adopt(self.stand_ins)
        layout, where = layout_called(self.recipe.layout, self.dataset), choose_device(device)
        more = {"known": self.known, "workers": self.workers}
        return FolderSampling(self.sources, self.instances, self.out, layout, self.recipe, where, **more)

    def run(
        self,
        shards: Iterable[int],
        maker: FolderSampling,
        done: Callable[[ShardTold], None],
        *,
        times: StageTimes | None = None,
    ) -> None:
        """See `SharedJob`. Told are reports of shards, with entries of their meshes in their order."""
        self.run_items(
            shards,
            lambda numbers: (
                entry_of(outcome, self.sources[number], self.recipe.sign) for number, outcome in maker.some(numbers)
            ),
            done,
            maker.times,
        )


def entry_of(outcome: Done[SampledMesh] | Failed, source: Path, sign: Sign) -> MeshEntry:
    """The report's entry of a mesh.

    Raises:
        FormatError: The disk is full, which every other mesh would fail by, too.
        Exception: What is no user's mistake.
    """
    if isinstance(outcome, Failed):
        return MeshEntry(mesh=shown(source), state="failed", reason=reason_of(outcome))
    found = outcome.value
    if found.there:
        more = {"triangles": found.triangles, "closed": found.closed}
        return MeshEntry(mesh=shown(source), state="there already", sign=sign, **more)
    unsure = [f"the flood does not prove the sign of {counted(found.unsure, 'sample')}"] if found.unsure else []
    return MeshEntry(
        mesh=shown(source),
        state="done",
        output=None if found.path is None else shown(found.path),
        triangles=found.triangles,
        closed=found.closed,
        sign=sign,
        inside=found.inside,
        warnings=unsure,
        seconds=round(found.seconds, 4),
    )
