"""`sdm train deepsdf`: one network for a class of shapes, and a code for each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import print_line

if TYPE_CHECKING:
    from sdm.core.mesh import TriangleMesh


def deepsdf(
    source: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="FAMILY|FOLDER")],
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    variant: Literal["published", "local"] = "local",
    count: int = 500,
    budget_s: Annotated[float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: none)")] = None,
    epochs: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the variant's)")] = None,
    batch_size: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the variant's)")] = None,
    points: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the variant's)")] = None,
    width: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the variant's)")] = None,
    seed: int = 0,
    device: Device = "auto",
    resume: bool = False,
    skip_bad: bool = False,
    split: Annotated[str | None, tyro.conf.arg(metavar="PART", help_behavior_hint="(default: all)")] = None,
    compile: Annotated[  # noqa: A002
        bool | None, tyro.conf.arg(help_behavior_hint="(default: on GPUs)")
    ] = None,
) -> None:
    """Train a DeepSDF auto-decoder on exact samples of closed meshes, made on the device, fresh in each step.

    Writes OUT/model.pt (for sdm encode and sdm decode), and OUT/checkpoint about every minute. The published variant is
    that of Park et al., CVPR 2019; it takes 2001 epochs unless a budget ends it before. The local one has no end of its
    own: give --budget-s or --epochs. Under torchrun the shapes of a batch are shared by the processes.

    Args:
        source: A family (cochlea, ...), or a folder of closed meshes, nested or not, which are turned if they are
            inside out.
        out: Folder for the model; made if it is not there.
        variant: published: one code a shape; local: codes on coarse grids too, for unseen shapes of small sets.
        count: Shapes of a family.
        budget_s: Seconds of training at most, over all restarts; the schedule fits itself to it.
        epochs: How often each shape is seen.
        batch_size: Shapes of a step, over all processes.
        points: Samples of each.
        width: Neurons of a hidden layer.
        seed: Whole number that everything random depends on.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
        resume: Go on from OUT/checkpoint if it is there. Without it an unfinished training is never replaced.
        skip_bad: Go on without the meshes of the folder that cannot be used; they are listed either way.
        split: The part of the folder to train on, of those that sdm split made of it.
        compile: Compile the network first.
    """
    from sdm.cli.common.progress import CountProgress
    from sdm.deepsdf import train
    from sdm.deepsdf.samples import ShapeSet
    from sdm.deepsdf.train.checkpoint import MODEL, refuse_unfinished_in
    from sdm.deepsdf.train.process_group import is_first, process_group
    from sdm.deepsdf.train.settings import VARIANTS
    from sdm.errors import MeshError, SDMError
    from sdm.io.maps.formats import check_file
    from sdm.training.budget import check_budget
    from sdm.training.checkpoints import training_folder

    given = {"epochs": epochs, "shapes": batch_size, "points": points, "width": width, "seed": seed}
    settings = VARIANTS[variant](**{name: value for name, value in given.items() if value is not None})
    if variant == "local" and budget_s is None and epochs is None:
        raise SDMError("say how long to train: --budget-s or --epochs")
    check_budget(budget_s)
    if not resume:
        refuse_unfinished_in(out)
    with process_group(device) as where:
        meshes, rejected = _meshes(source, count, split)
        if rejected and not skip_bad:
            raise MeshError(f"{rejected[0][1]}; --skip-bad goes on without it")
        found = ShapeSet(meshes, where, skip_bad=skip_bad)
        if is_first():
            for name, why in (*rejected, *found.rejected):
                print_line(f"sdm: {name} is not used: {why}", error=True)
        # Of several ranks the first writes.
        with training_folder(out, lock=is_first()), CountProgress("steps", budget_s=budget_s) as progress:
            # Before the training, not at its first checkpoint.
            check_file(out / MODEL)
            path = train(
                found,
                settings,
                out,
                names=found.names,
                spheres=found.spheres,
                budget_s=budget_s,
                device=where,
                resume=resume,
                compile_network=compile,
                progress=lambda step, steps, _: progress(step, steps),
            )
    if is_first():
        print_line(f"{path}: {len(found)} shapes of {source}, {path.stat().st_size / 2**20:.1f} MiB")


def _meshes(source: str, count: int, split: str | None) -> tuple[list[TriangleMesh], list[tuple[str, str]]]:
    """The meshes, and of each file that cannot be read its name and the reason."""
    from sdm.core.mesh import TriangleMesh
    from sdm.dataset.family_registry import describe, family_from
    from sdm.errors import SDMError
    from sdm.io import load_mesh, mesh_tree
    from sdm.io.meshes.split_file import files_of_part

    options: dict[str, Any] = {}
    known = describe(source, options)
    if count < 1:
        raise SDMError(f"--count is {count}; give 1 or more shapes")
    if "folder" in known:
        folder = Path(known["folder"])
        files, rejected = mesh_tree(folder), []
        meshes = []
        for path in files if split is None else files_of_part(folder, split, files):
            name = path.relative_to(folder).as_posix()
            try:
                mesh = load_mesh(path)
            except SDMError as error:
                rejected.append((name, str(error)))
            else:
                # Codes and samples know shapes by their names, which in nested folders may be alike.
                meshes.append(TriangleMesh(mesh.vertices, mesh.faces, name, check=False))
        return meshes, rejected
    if split is not None:
        raise SDMError(f"{source} is a family, and has no part {split!r}")
    family = family_from(known)
    theta = family.sample(count, device="cpu")
    made = [
        TriangleMesh(group.vertices[0], group.faces, f"{family.name}-{number}", check=False)
        for number in range(count)
        for group in family.groups(theta[number : number + 1])
    ]
    return made, []
