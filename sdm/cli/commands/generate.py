"""`sdm generate`: a dataset of signed distance maps of random shapes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import print_line

if TYPE_CHECKING:
    from collections.abc import Callable

    from sdm.core.grid import Grid
    from sdm.shapes import Family


def generate(
    source: Annotated[
        tyro.conf.Positional[str | None], tyro.conf.arg(metavar="FAMILY|FOLDER", help_behavior_hint="")
    ] = None,
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    family: Annotated[str | None, tyro.conf.arg(metavar="FAMILY", help_behavior_hint="")] = None,
    count: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None,
    # None, so that --resume can tell what was requested.
    resolution: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: 64)")] = None,
    margin: Annotated[float | None, tyro.conf.arg(metavar="SHARE", help_behavior_hint="(default: 0.05)")] = None,
    seed: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: 0)")] = None,
    sampler: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: uniform)")] = None,
    dtype: Annotated[
        Literal["float32", "float16"] | None,
        tyro.conf.arg(metavar="{float32,float16}", help_behavior_hint="(default: float32)"),
    ] = None,
    truncate: Annotated[float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: none)")] = None,
    sign: Annotated[
        Literal["winding", "flood", "none"] | None,
        tyro.conf.arg(metavar="{winding,flood,none}", help_behavior_hint="(default: winding)"),
    ] = None,
    hole_size: Annotated[
        float | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="(default: two voxels)")
    ] = None,
    shard: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: 256 MiB of them)")] = None,
    compression: Annotated[
        Literal["zstd", "none"] | None, tyro.conf.arg(metavar="{zstd,none}", help_behavior_hint="(default: zstd)")
    ] = None,
    device: Device = "auto",
    ray: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: no cluster)")] = None,
    resume: bool = False,
    verify: bool = False,
    skip_bad: bool = False,
    split: Annotated[str | None, tyro.conf.arg(metavar="PART", help_behavior_hint="(default: all)")] = None,
    open_meshes: Annotated[
        Literal["reject", "keep"] | None,
        tyro.conf.arg(metavar="{reject,keep}", help_behavior_hint="(default: reject with --sign winding, else keep)"),
    ] = None,
    orient: Annotated[
        Literal["auto", "parts", "keep"] | None,
        tyro.conf.arg(metavar="{auto,parts,keep}", help_behavior_hint="(default: auto)"),
    ] = None,
    triangles: Annotated[
        int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the family's own)")
    ] = None,
    rotation: Annotated[
        float | None, tyro.conf.arg(metavar="DEGREES", help_behavior_hint="(default: all rotations alike)")
    ] = None,
    scale: Annotated[
        tuple[float, float] | None, tyro.conf.arg(metavar="LOW HIGH", help_behavior_hint="(default: 0.9 1.1)")
    ] = None,
    shift: Annotated[float | None, tyro.conf.arg(metavar="SHARE", help_behavior_hint="(default: 0.1)")] = None,
    warp: Annotated[float | None, tyro.conf.arg(metavar="BOUND", help_behavior_hint="(default: 0.5)")] = None,
) -> int | None:
    """Write a dataset of exact signed distance maps of random shapes: negative inside, in the shapes' unit of length.

    The shapes are a family (cochlea, cuboid, rhomboid, ellipsoid, cylinder, geometric-shapes, FILE.py:NAME of your own,
    or a shape model, MODEL.npz) or your own closed meshes in a folder, varied at random. The dataset is a Zarr 3
    folder, and holds bit for bit what sdm.SDMStream yields for the same seed; sdm.SDMDataset reads it. Until it is
    complete it is called OUT.part.

    Args:
        source: A family, or a folder of meshes. With --resume or --verify it may be left out: the dataset knows.
        out: The dataset to write, for example cochlea.zarr.
        family: The same as a family in the first place, as the other commands take it.
        count: Number of samples.
        resolution: Voxels along each axis, of a cube that holds every shape.
        margin: Room around the shapes, as a share of the longest edge of their box.
        seed: Whole number that the samples depend on.
        sampler: uniform, sobol, chebyshev (denser towards the ends of each parameter), grid:N (N points along each
            parameter), grid:N:ordered, or mixture:SHARE (of grid:5).
        dtype: Type of the maps in the dataset.
        truncate: Distances beyond this length become this, with their sign.
        sign: winding goes by the generalised winding number; flood calls inside what a ball from outside cannot reach,
            for folders of meshes whose faces do not say; none writes unsigned distances.
        hole_size: With --sign flood, the ball's diameter: narrower gaps are closed.
        shard: Samples in one file, which is what is lost at most if the work is cut off.
        compression: zstd loses nothing; none reads faster.
        device: auto, cpu, cuda or cuda:N; auto is every GPU of this machine, or the CPU if there is none.
        ray: Share the work among the GPUs of this Ray cluster; "auto" is the one this machine belongs to.
        resume: Finish a dataset that was cut off. Options may be left out; those that are given must be its own.
        verify: Look for damaged shards of a dataset, and make them again.
        skip_bad: Go on without the files of the folder that cannot be used; they are listed either way.
        split: The part of the folder to use, of those that sdm split made of it.
        open_meshes: What to do with files of the folder whose mesh has holes or turned faces; with --sign winding the
            inside of one that is kept follows the generalised winding number.
        orient: auto turns components of the folder's meshes that are inside out; parts turns each patch of faces
            outward by what sees it from outside; keep takes them as they are.
        triangles: About how many triangles a shape of a family has.
        rotation: Largest random rotation of the folder's meshes.
        scale: Least and greatest random factor of the folder's meshes.
        shift: Largest random shift of the folder's meshes, as a share of their half-length.
        warp: How far the smooth random warp of the folder's meshes may bend, 0 to 0.95.
    """
    from sdm.cli.common.imports_that_stay import imports_that_stay
    from sdm.runtime import early_device

    with imports_that_stay():
        import sdm.kernels  # noqa: F401

        early_device.begin(device if ray is None else early_device.CPU)
        import torch

        from sdm import dataset
        from sdm.cli.common.progress import CountProgress
        from sdm.dataset.writer import check_options, check_place
        from sdm.errors import SDMError
        from sdm.io.files.stand_in import shown
        from sdm.runtime.pipeline.stage_times import StageTimes
        from sdm.runtime.sharing.devices import devices_for

    if family is not None:
        source = _named(family, source)
    options = {
        "open_meshes": open_meshes,
        "orient": orient,
        "split": split,
        "triangles": triangles,
        "rotation": rotation,
        "scale": scale,
        "shift": shift,
        "warp": warp,
    }
    asked: dict[str, Any] = {
        "seed": seed,
        "sampler": sampler,
        "truncate": truncate,
        "sign": sign,
        "hole_size": hole_size,
        "dtype": None if dtype is None else getattr(torch, dtype),
        "shard": shard,
        "compression": compression,
    }
    asked = {key: value for key, value in asked.items() if value is not None}
    if verify:
        _refuse_to_verify(
            {"count": count, "resolution": resolution, "margin": margin, "resume": resume or None, **asked}
        )
        return _verify(source, options, out, device, ray)
    given = {key: value for key, value in options.items() if value is not None}
    begun, first = None, {}
    if resume and (source is None or _is_begun(out)):
        recipe, there, begun, first = _recipe(out)
        asked, count = {**recipe, **asked}, there if count is None else count
    if source is None:
        if not resume:
            raise SDMError(
                "say what to generate: a family (cochlea, ...) or a folder of meshes; see sdm generate --help"
            )
        known = _changed(first, given)
    else:
        known = _describe(source, options, sign)
        if all(known.get(key) == first.get(key) for key in ("family", "folder", "file")):
            # Named once more, it is what it was begun as, but for what is asked for.
            known = _describe(source, {**_options(first), **given}, asked.get("sign"))
    if skip_bad and "folder" not in known:
        raise SDMError("--skip-bad is for a folder of meshes: a family has no bad ones")
    if count is None:
        raise SDMError("say how many samples: --count")
    # Refused now is what can be before meshes are read and kernels compiled.
    check_options(count, **asked)
    if not (resume and out.exists()):
        check_place(out, resume=resume)
    if ray is None:
        devices_for(device)
    grid_of = _grid_of(begun, resolution, margin)
    shapes = _family(known, skip_bad or source is None, named=source is not None)
    grid = grid_of(shapes)
    times = StageTimes()
    with CountProgress("maps", times) as progress:
        where: dict[str, Any] = {"device": device, "ray": ray, "resume": resume}
        dataset.generate(shapes, grid, count, out, source=known, progress=progress, times=times, **where, **asked)
    written = sum(f.stat().st_size for f in out.rglob("*") if f.is_file())
    print_line(
        f"{shown(out)}: {count:,} maps of {shapes.name}, {' x '.join(map(str, grid.shape))} voxels of "
        f"{grid.spacing[0]:.4g}, {written / 2**20:,.1f} MiB"
    )
    return None


def _named(family: str, source: str | None) -> str:
    """The family of --family.

    Raises:
        SDMError: Something else is named besides, or it is a folder.
    """
    from sdm.dataset.family_registry import is_family
    from sdm.errors import SDMError

    if source is not None:
        raise SDMError(f"{source} and --family {family} both say what to generate: give one of them")
    if not is_family(family):
        raise SDMError(f"--family takes a family; give the folder of meshes in the first place: {family}")
    return family


def _refuse_to_verify(options: dict[str, Any]) -> None:
    from sdm.errors import SDMError

    for name in (name for name, value in options.items() if value is not None):
        raise SDMError(f"--verify makes shards again as the dataset was begun: leave out --{name.replace('_', '-')}")


def _changed(known: dict[str, Any], options: dict[str, Any]) -> dict[str, Any]:
    """The source that a dataset was begun with, with other options.

    Raises:
        SDMError: It is a family of a user's, whose file is to be named.
    """
    from sdm.errors import SDMError

    if not options:
        return known
    if "file" in known:
        raise SDMError("name the dataset's family to change its options: code is run only where it is named")
    return _describe(
        known.get("family") or known.get("folder") or "", {**_options(known), **options}, known.get("sign")
    )


def _grid_of(begun: Grid | None, resolution: int | None, margin: float | None) -> Callable[[Family], Grid]:
    """The way from a family to its grid, which may be that of a dataset that was begun.

    Raises:
        GridError: No family has such a grid, or its map does not fit into memory.
    """
    import torch

    from sdm.core.device import require_memory
    from sdm.engine.arguments import described
    from sdm.shapes.family import check_resolution

    if begun is not None and resolution in (None, begun.shape[0]) and margin is None:
        return lambda _: begun
    voxels = resolution if resolution is not None else 64 if begun is None else begun.shape[0]
    room = 0.05 if margin is None else margin
    cube = check_resolution(voxels, room)
    require_memory(cube.nbytes, torch.device("cpu"), described(cube))
    return lambda family: family.grid(voxels, margin=room)


def _verify(source: str | None, options: dict[str, Any], out: Path, device: str, ray: str | None) -> int | None:
    from sdm import dataset
    from sdm.cli.common.progress import CountProgress
    from sdm.dataset.family_registry import source_of
    from sdm.dataset.layout import part_of, shard_count
    from sdm.dataset.manifest import read_manifest
    from sdm.dataset.repair import damaged, mend_arrays

    if not out.exists() and part_of(out).exists():
        out = part_of(out)
    manifest = read_manifest(out)
    if mended := mend_arrays(out):
        print_line(f"{out}: the zarr.json of {' and '.join(mended)} was damaged and has been written again")
    with CountProgress("maps checked") as progress:
        found = damaged(out, progress)
    if not found:
        count = shard_count(manifest)
        print_line(f"{out}: {f'all {count:,} shards are' if count > 1 else 'its shard is'} sound")
        return None
    known = source_of(manifest)
    if source is not None:
        known = _describe(source, options, known.get("sign"))
    family = _family(known, True, named=source is not None)
    with CountProgress("maps") as progress:
        dataset.verify(out, family, device=device, ray=ray, shards=found, progress=progress)
    numbers = ", ".join(map(str, found[:10])) + (", ..." if len(found) > 10 else "")
    print_line(
        f"{out}: {len(found):,} of {shard_count(manifest):,} shards were damaged and have been made again: {numbers}"
    )
    return None


def _is_begun(out: Path) -> bool:
    from sdm.dataset.layout import part_of

    return any((place / "zarr.json").is_file() for place in (out, part_of(out)))


def _recipe(out: Path) -> tuple[dict[str, Any], int, Any, dict[str, Any]]:
    """Options, count, grid and source that an unfinished dataset was begun with."""
    import torch

    from sdm.core.grid import Grid
    from sdm.dataset.family_registry import source_of
    from sdm.dataset.layout import part_of
    from sdm.dataset.manifest import read_manifest

    part = part_of(out)
    manifest = read_manifest(part if part.exists() else out)
    recipe = manifest["recipe"]
    options = {key: recipe[key] for key in ("seed", "sampler", "truncate", "sign", "hole_size")}
    options |= {"dtype": getattr(torch, recipe["dtype"])}
    options |= {key: manifest[key] for key in ("shard", "compression")}
    grid = Grid(**recipe["grid"])
    return options, manifest["count"], grid, source_of(manifest)


def _options(known: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in known.items() if key not in ("family", "folder", "file", "reference", "sign")}


def _describe(source: str, options: dict[str, Any], sign: str | None = None) -> dict[str, Any]:
    from sdm.dataset.family_registry import describe

    known = describe(source, options)
    # By the sign it depends which meshes of a folder can be used.
    return {**known, "sign": sign} if "folder" in known and sign not in (None, "winding") else known


def _family(known: dict[str, Any], skip_bad: bool, *, named: bool) -> Family:
    from sdm.dataset.family_registry import family_from
    from sdm.errors import MeshError
    from sdm.shapes.triage import FLOOD, KEEP_OPEN

    def as_options(reason: str) -> str:
        return reason.replace(KEEP_OPEN, "--open-meshes keep").replace(FLOOD, "--sign flood")

    try:
        family = family_from(known, named=named)
    except MeshError as error:
        raise MeshError(as_options(str(error))) from error
    for name, reason in family.rejected:
        print_line(f"sdm: {name} is not used: {as_options(reason)}", error=True)
    if family.rejected and not skip_bad:
        files = "1 file" if len(family.rejected) == 1 else f"{len(family.rejected)} files"
        raise MeshError(
            f"{files} of {known['folder']} cannot be used: mend what is said, or go on without by --skip-bad"
        )
    return family
