"""`sdm train deepsdf`: one network for a class of shapes, and a code for each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

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
    shapes: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the variant's)")] = None,
    points: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the variant's)")] = None,
    width: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the variant's)")] = None,
    seed: int = 0,
    device: str = "auto",
    resume: bool = False,
    compile: Annotated[  # noqa: A002
        bool | None, tyro.conf.arg(help_behavior_hint="(default: on GPUs)")
    ] = None,
) -> None:
    """Train a DeepSDF auto-decoder on exact samples of closed meshes, made on the device, fresh in each step.

    Writes OUT/model.pt (for sdm encode and sdm decode), and OUT/checkpoint about every minute. The published variant is
    that of Park et al., CVPR 2019; it takes 2001 epochs unless a budget ends it before. The local one has no end of its
    own: give --budget-s or --epochs. Under torchrun the shapes of a batch are shared by the processes.

    Args:
        source: A family (cochlea, ...), or a folder of closed meshes, which are turned if they are inside out.
        out: Folder for the model; made if it is not there.
        variant: published: one code a shape; local: codes on coarse grids too, for unseen shapes of small sets.
        count: Shapes of a family.
        budget_s: Seconds of training at most, over all restarts; the schedule fits itself to it.
        epochs: How often each shape is seen.
        shapes: Shapes of a batch, over all processes.
        points: Samples of each.
        width: Neurons of a hidden layer.
        seed: Whole number that everything random depends on.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
        resume: Go on from OUT/checkpoint if it is there. Without it an unfinished training is never replaced.
        compile: Compile the network first.
    """
    from sdm.cli.common.progress import CountProgress
    from sdm.deepsdf import train
    from sdm.deepsdf.samples import ShapeSet
    from sdm.deepsdf.train.checkpoint import MODEL, refuse_unfinished_in
    from sdm.deepsdf.train.ranks import is_first, process_group
    from sdm.deepsdf.train.settings import VARIANTS
    from sdm.errors import SDMError
    from sdm.io.maps.formats import check_file
    from sdm.training.budget import check_budget
    from sdm.training.checkpoints import training_folder

    given = {"epochs": epochs, "shapes": shapes, "points": points, "width": width, "seed": seed}
    settings = VARIANTS[variant](**{name: value for name, value in given.items() if value is not None})
    if variant == "local" and budget_s is None and epochs is None:
        raise SDMError("say how long to train: --budget-s or --epochs")
    check_budget(budget_s)
    if not resume:
        refuse_unfinished_in(out)
    with process_group(device) as where:
        found = ShapeSet(_meshes(source, count), where)
        # Of several ranks the first writes.
        with training_folder(out, lock=is_first()), CountProgress("steps") as progress:
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
        print(f"{path}: {len(found)} shapes of {source}, {path.stat().st_size / 2**20:.1f} MiB")


def _meshes(source: str, count: int) -> list[TriangleMesh]:
    from sdm.core.mesh import TriangleMesh
    from sdm.dataset.family_registry import FAMILIES, describe, family_from
    from sdm.errors import SDMError
    from sdm.io.meshes.load import load_mesh, mesh_files

    options: dict[str, Any] = {}
    known = describe(source, options)
    if count < 1:
        raise SDMError(f"--count is {count}; give 1 or more shapes")
    if source not in FAMILIES:
        return [load_mesh(path) for path in mesh_files(known["folder"])]
    family = family_from(known)
    theta = family.sample(count, device="cpu")
    return [
        TriangleMesh(group.vertices[0], group.faces, f"{source}-{number}", check=False)
        for number in range(count)
        for group in family.groups(theta[number : number + 1])
    ]
