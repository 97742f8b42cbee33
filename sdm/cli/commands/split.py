"""`sdm split`: training, validation and test of a folder of meshes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import counted, print_line


def split(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FOLDER")],
    /,
    *,
    out: Annotated[
        Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE", help_behavior_hint="(default: FOLDER/split.json)")
    ] = None,
    val: float = 0.1,
    test: float = 0.1,
    seed: int = 0,
    twins: float = 0.01,
    group: Annotated[str | None, tyro.conf.arg(metavar="REGEX", help_behavior_hint="(default: none)")] = None,
    device: Device = "auto",
    skip_bad: bool = False,
) -> None:
    """Deal the meshes of a folder to training, validation and test, so that no near twins are on two sides.

    Writes the lists, which sdm generate FOLDER --split train, sdm train deepsdf FOLDER --split train and
    sdm.shapes.make_family("mesh-folder", source=FOLDER, split="val") take.

    Args:
        folder: Folder of meshes, nested or not.
        out: JSON file to write.
        val: Share of the meshes for validation; 0 for none.
        test: Share of the meshes for tests; 0 for none.
        seed: Whole number that the order of dealing depends on.
        twins: Meshes that are nearer to each other than this share of their size, as means of exact distances both ways
            once one is laid on the other, stay together; 0 looks for none.
        group: Regular expression; meshes whose paths below the folder match it alike stay together: "^[^/]+" for the
            first folder, "patient([0-9]+)" for what is in the brackets.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
        skip_bad: Go on without the meshes that cannot be read; they are listed either way.
    """
    from sdm.cli.common.inputs import refuse_inputs
    from sdm.cli.common.progress import CountProgress
    from sdm.core.device import choose_device
    from sdm.errors import MeshError
    from sdm.io import mesh_tree
    from sdm.io.maps.formats import check_file
    from sdm.io.meshes.split_file import NAME, write_split
    from sdm.sampling.split import split_folder

    if not folder.is_dir():
        raise MeshError(f"{folder} is not a folder; give a folder of meshes")
    files = mesh_tree(folder)
    if not files:
        raise MeshError(f"no mesh file was found in {folder}")
    target = folder / NAME if out is None else out
    refuse_inputs([target], files)
    check_file(target)
    names = [file.relative_to(folder).as_posix() for file in files]
    shares = {part: share for part, share in (("val", val), ("test", test)) if share}
    where = choose_device(device)
    with CountProgress("meshes") as progress:
        found = split_folder(names, files, shares, seed=seed, twins=twins, group=group, device=where, progress=progress)
    for name, reason in found.skipped:
        print_line(f"sdm: {name} is not used: {reason}", error=True)
    if found.skipped and not skip_bad:
        many, them = counted(len(found.skipped), "mesh", "meshes"), "it" if len(found.skipped) == 1 else "them"
        raise MeshError(f"{many} of {folder} cannot be used: mend {them}, or go on by --skip-bad")
    pairs = [[one, other, float(f"{distance:.6g}")] for one, other, distance in found.twins]
    more = {"seed": seed, "shares": shares, "near_twins_below": twins, "group": group, "twins": pairs}
    write_split(target, found.parts, **more, skipped=[list(pair) for pair in found.skipped])
    counts = ", ".join(f"{len(own):,} {part}" for part, own in found.parts.items())
    print_line(f"{target}: {counts}; {len(found.twins):,} pairs of near twins, kept on one side")
