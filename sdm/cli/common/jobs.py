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
from sdm.engine.api import MeshIndex
from sdm.errors import SDMError
from sdm.inspect import orient_outward
from sdm.io import check_target, grid_like, load_mesh, write_streamed
from sdm.io.maps.api import made_from
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
        orient: Whether closed meshes that are inside out are turned.
        resume: Whether maps of the same triangles that are there on the same grid are left.
    """

    resolution: int | tuple[int, ...] | None
    spacing: float | tuple[float, ...] | None
    like: Grid | None
    like_image: Path | None
    margin: float
    device: torch.device
    orient: Literal["keep", "auto"]
    resume: bool

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
    mesh = load_mesh(source)
    grid = settings.grid(mesh)
    mesh = mesh.to(settings.device)
    outward = orient_outward(mesh)
    turned = outward is not mesh
    measured = outward if settings.orient == "auto" else mesh
    digest = digest_of(measured)
    if settings.resume and _finished(target, grid, digest):
        progress.print(f"{mesh.name}: {target} is there already")
        return
    refuse_inputs([target], [settings.like_image])
    index = MeshIndex(measured, settings.device)
    ambiguous = write_streamed(index, grid, target, progress=progress.share, made_from=digest)
    seconds = time.perf_counter() - start

    spacing = " x ".join(f"{s:.4g}" for s in (grid.spacing[:1] if len(set(grid.spacing)) == 1 else grid.spacing))
    progress.print(
        f"{mesh.name}: {len(mesh):,} triangles, {' x '.join(map(str, grid.shape))} voxels of {spacing}, "
        f"{seconds:.2f} s on {settings.device}, written to {target}"
    )
    for warning in _warnings(index.closed, turned, ambiguous, settings.orient, grid):
        progress.print(f"sdm: warning: {mesh.name} {warning}", warn=True)


def _finished(target: Path, grid: Grid, digest: str) -> bool:
    """True if a file is a map, on this grid, of the mesh with this digest."""
    try:
        return grid_like(target) == grid and made_from(target) == digest
    except SDMError:
        return False


def _warnings(closed: bool, turned: bool, ambiguous: int, orient: str, grid: Grid) -> list[str]:
    found = []
    if turned and orient == "auto":
        found.append("was inside out and has been turned")
    elif turned:
        found.append("is inside out, so nothing counts as inside: --orient auto turns it")
    if not closed and ambiguous:
        share = 100 * ambiguous / grid.size
        found.append(
            f"is not closed: whether {ambiguous:,} voxels ({share:.2g} %) are inside is ambiguous; "
            "the sign follows the generalised winding number (sdm inspect tells more)"
        )
    elif not closed:
        found.append("is not closed, but no voxel is ambiguous")
    return found
