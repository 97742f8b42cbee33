"""The work of `sdm compute`: mesh by mesh, with what was done and what to know about it."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from sdm.cli.common.error_sentence import sentence_of
from sdm.cli.common.inputs import refuse_inputs
from sdm.cli.common.progress import FileProgress
from sdm.core.grid import Grid
from sdm.core.mesh import TriangleMesh
from sdm.engine.arguments import Orient, Sign, oriented
from sdm.engine.map_check import doubts_about
from sdm.engine.mesh_index import MeshIndex
from sdm.errors import SDMError
from sdm.io import check_target, grid_like, load_mesh, write_streamed
from sdm.io.maps.api import VoxelCounts, made_from
from sdm.io.maps.record import digest_of


@dataclass(frozen=True)
class Settings:
    """Settings that are the same for all meshes.

    Args:
        resolution: Voxels along each axis, one number or three; None for the default.
        spacing: Voxel size in place of it: one length or three.
        like: The grid itself in place of it.
        like_image: The file that it is of, which is not written over.
        margin: Room around the mesh, as a share of its box.
        device: Where to compute.
        orient: Whether faces that disagree, and parts that are inside out, are turned.
        scale: What the vertices are multiplied by.
        mesh_space: `"lps"` negates their x and y.
        sign: The method by which maps are signed.
        hole_size: Of a flood, the narrowest gaps that it passes.
        resume: Whether maps of the same triangles that are there on the same grid are left.
    """

    resolution: int | tuple[int, ...] | None
    spacing: float | tuple[float, ...] | None
    like: Grid | None
    like_image: Path | None
    margin: float
    device: torch.device
    orient: Orient
    resume: bool
    sign: Sign = "winding"
    hole_size: float | None = None
    scale: float = 1.0
    mesh_space: Literal["ras", "lps"] = "ras"

    def grid(self, mesh: TriangleMesh) -> Grid:
        """The grid of a mesh's map."""
        if self.like is not None:
            return self.like
        return Grid.around(mesh, resolution=self.resolution, spacing=self.spacing, margin=self.margin)


def run(jobs: list[tuple[Path, Path]], settings: Settings) -> int | None:
    """Compute the map of each mesh into its file.

    Args:
        jobs: Pairs of a mesh file and the file to write.
        settings: What is the same for all.

    Returns:
        2 if some of several meshes failed, which is then said on stderr; None if none did. A mesh that is alone
        raises its error.
    """
    failed: list[tuple[Path, str]] = []
    with FileProgress(len(jobs)) as progress:
        for source, target in jobs:
            progress.begin(source.name)
            try:
                _compute(source, target, settings, progress)
            except Exception as error:
                sentence = sentence_of(error)
                if sentence is None or len(jobs) == 1:
                    raise
                failed.append((source, sentence))
            progress.end()
    if not failed:
        return None
    for source, sentence in failed:
        # Most sentences name the file already.
        named = sentence if source.name in sentence else f"{source}: {sentence}"
        print(f"sdm: {named}", file=sys.stderr)
    print(f"sdm: {len(failed)} of {len(jobs)} meshes failed; the others are done", file=sys.stderr)
    return 2


def _compute(source: Path, target: Path, settings: Settings, progress: FileProgress) -> None:
    start = time.perf_counter()
    check_target(target)
    mesh = _placed(load_mesh(source), settings)
    grid = settings.grid(mesh)
    measured = oriented(mesh, settings.orient, settings.device)
    how = "" if settings.sign == "winding" else f" {settings.sign} {settings.hole_size}"
    digest = digest_of(measured, how)
    if settings.resume and _finished(target, grid, digest):
        progress.print(f"{mesh.name}: {target} is there already")
        return
    refuse_inputs([target], [settings.like_image])
    index = MeshIndex(measured, settings.device, warn=False)
    counts = write_streamed(
        index,
        grid,
        target,
        progress=progress.share,
        made_from=digest,
        sign=settings.sign,
        hole_size=settings.hole_size,
    )
    seconds = time.perf_counter() - start

    spacing = " x ".join(f"{s:.4g}" for s in (grid.spacing[:1] if len(set(grid.spacing)) == 1 else grid.spacing))
    progress.print(
        f"{mesh.name}: {len(mesh):,} triangles, {' x '.join(map(str, grid.shape))} voxels of {spacing}, "
        f"{seconds:.2f} s on {settings.device}, written to {target}"
    )
    said = [] if measured is mesh else [_turned(mesh, measured)]
    doubts = doubts_about(measured, grid, counts.inside, settings.sign)
    said += [f": {doubt}" for doubt in doubts]
    if settings.sign == "winding":
        said += _about_gaps(index.closed, counts, bool(doubts), grid)
    for warning in said:
        progress.print(f"sdm: warning: {mesh.name}{warning}", warn=True)


def _placed(mesh: TriangleMesh, settings: Settings) -> TriangleMesh:
    """The mesh in the grid's unit and space."""
    if settings.scale == 1 and settings.mesh_space == "ras":
        return mesh
    side = -1.0 if settings.mesh_space == "lps" else 1.0
    factors = torch.tensor([side, side, 1.0], dtype=torch.float64) * settings.scale
    # Half a turn about z: faces look where they looked.
    return TriangleMesh(mesh.vertices.double() * factors, mesh.faces, mesh.name)


def _finished(target: Path, grid: Grid, digest: str) -> bool:
    """True if a file is a map, on this grid, of the mesh with this digest."""
    try:
        return grid_like(target) == grid and made_from(target) == digest
    except SDMError:
        return False


def _turned(mesh: TriangleMesh, measured: TriangleMesh) -> str:
    """Said of a mesh some of whose faces were turned."""
    count = int((mesh.faces != measured.faces.to(mesh.device)).any(1).sum())
    if count == len(mesh):
        return " was inside out and has been turned"
    return f": {count:,} of its {len(mesh):,} faces looked inward, or disagreed with others, and have been turned"


def _about_gaps(closed: bool, counts: VoxelCounts, doubtful: bool, grid: Grid) -> list[str]:
    """Said of a mesh that is not closed, where there is anything to add to the doubts about it."""
    if closed:
        return []
    if counts.ambiguous:
        share = 100 * counts.ambiguous / grid.size
        text = (
            f" is not closed: whether {counts.ambiguous:,} voxels ({share:.2g} %) are inside is ambiguous; "
            "the sign follows the generalised winding number (sdm inspect tells more)"
        )
        return [text]
    if doubtful:
        return []
    return [" is not closed, but no voxel is ambiguous" if counts.inside else " is not closed, and no voxel is inside"]
