"""`sdm train sdmnn`: surrogates of the cochlea family, and of any other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from sdm.cli.common.argument_types import Device
from sdm.cli.common.printed_line import print_line


def sdmnn(
    *,
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])],
    family: Annotated[str | None, tyro.conf.arg(metavar="FAMILY", help_behavior_hint="(default: the cochlea)")] = None,
    resolution: int = 48,
    model: Literal["sdmnn-plus", "sdmnn"] = "sdmnn-plus",
    modes: int = 208,
    channels: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the model's)")] = None,
    pointwise: int = 0,
    recipe: Literal["mostly-online", "paper", "static", "online", "ends"] = "mostly-online",
    loss: Literal["surface", "mse"] = "surface",
    budget_s: Annotated[float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: none)")] = None,
    steps: int = 100_000,
    batch_size: int = 32,
    fresh: int = 4,
    store: int = 16_384,
    fill_share: float = 0.25,
    warm_share: float = 0.2,
    learning_rate: float = 1e-3,
    surface: float = 1.0,
    dice: float = 0.0,
    flips: float = 0.0,
    hard: float = 0.0,
    float32: bool = False,
    eikonal: float = 0.01,
    sobolev: float = 0.05,
    start: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None,
    seed: int = 0,
    checkpoint: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: in OUT)")] = None,
    device: Device = "auto",
) -> int | None:
    """Train a surrogate: from the parameters of a family of shapes to a signed distance map.

    With --family it is of any family of 1 to 64 parameters, on a grid of its own: modes of the maps, polynomials and a
    small network (only --resolution, --budget-s, --seed and --device matter then). OUT then has the surrogate, for
    `sdm predict --model OUT`, and its card: errors on fresh shapes, the worst case found by search, speed, a picture.
    Without it, a network of the cochlea family:

    Writes OUT/MODEL-RECIPE.safetensors with its description, curves, and a checkpoint from which the same command
    goes on if it is cut off. Maps are made as they are needed, by the exact engine.

    Args:
        out: Folder to write to; made if it is not there.
        family: cochlea, FILE.py:NAME of yours (the file is run), a shape model's MODEL.npz, ...
        resolution: Voxels along each axis, with --family.
        model: sdmnn is the network of Wang et al., MIDL 2020; sdmnn-plus is quicker and more accurate, with
            a file seven times as large.
        modes: Modes of sdmnn-plus; fewer than there are maps in the store when training begins.
        channels: Feature maps of the network.
        pointwise: Features of single blocks at the end of sdmnn-plus; it is then of a second kind, which needs fewer
            modes for the same errors (152 with 64 of these).
        recipe: paper is 625 static maps and random ones, half each; static the 625 alone; online random
            ones alone; of mostly-online's samples a tenth are from the 625 and from the 16 corners of the parameters'
            box, the others random, denser towards the ends of each parameter; ends is random ones alone, half of them
            still denser there and a quarter among the smallest shapes, and none a corner.
        loss: surface weights absolute errors to the surface and uses the terms below; mse is the paper's.
        budget_s: Seconds of training at most; the learning rate follows the clock.
        steps: Steps of training at most, if that is sooner.
        batch_size: Maps of a step.
        fresh: New maps in each step; the others of a batch are drawn from the latest. 0: all are made before the first.
        store: How many of the latest maps are kept, 0.4 MB each on the device.
        fill_share: Share of the seconds in which the store is filled first.
        warm_share: Share of the seconds for the coefficients of sdmnn-plus before the first step.
        learning_rate: The highest learning rate.
        surface: Weight of the error at the surface, beside that of all voxels.
        dice: Weight of what is lost of the Dice coefficient; shapes that lose much count for more.
        flips: Weight of the voxels on the wrong side of the surface; likewise.
        hard: Share of a batch that is drawn among the shapes that had most of these.
        float32: Train in float32 on a GPU too: slower than bfloat16, for the end of a training.
        eikonal: Weight of the slope's distance from 1.
        sobolev: Weight of the error of the derivatives by the parameters.
        start: Weights to go on from, for example the shipped ones; their sizes replace --modes and --channels,
            but with --pointwise weights without such features get them and keep --modes of their modes.
        seed: Whole number that the training depends on.
        checkpoint: File of the checkpoint, up to 100 MB.
        device: auto, cpu, cuda or cuda:N; auto is a GPU if there is one.
    """
    from sdm.cli.common.inputs import refuse_inputs
    from sdm.core.device import choose_device
    from sdm.surrogate.infer.weights_file import save_weights, training_of
    from sdm.surrogate.train.settings import Settings, begin
    from sdm.surrogate.train.training import Trainer
    from sdm.training.checkpoints import training_folder

    if family is not None:
        from sdm.cli.commands.trainings.family_surrogate import train_of_family

        train_of_family(family, out, budget_s=budget_s, resolution=resolution, seed=seed, device=device)
        return None
    plain = loss == "mse"
    settings = Settings(
        model=model,
        modes=modes,
        channels=channels,
        pointwise=pointwise,
        recipe=recipe,
        loss=loss,
        steps=steps,
        budget_s=budget_s,
        batch_size=batch_size,
        fresh=fresh,
        store=store,
        fill_share=fill_share,
        warm_share=warm_share,
        rate=learning_rate,
        surface=surface,
        dice=0.0 if plain else dice,
        flips=0.0 if plain else flips,
        hard=hard,
        float32=float32,
        eikonal=0.0 if plain else eikonal,
        sobolev=0.0 if plain else sobolev,
        start=None if start is None else str(start),
        seed=seed,
    )
    name = f"{model}-{recipe}"
    curves = out / name
    target = out / f"{name}.safetensors"
    refuse_inputs([target], [start])
    if start is not None:
        # Before a folder is made for it.
        begin(settings)
    where = choose_device(device)
    # An unfinished training is gone on with by itself.
    with training_folder(curves):
        trainer = Trainer(
            settings,
            device=where,
            checkpoint=out / f"{name}.checkpoint" if checkpoint is None else checkpoint,
            curves=curves,
            report=lambda line: print(line, flush=True),
        )
        trained = trainer.run()
        facts = {**settings.record(), "start": start and start.name}
        facts |= {"step": trainer.step, "seconds": round(trainer.clock.seconds, 1)}
        before = {} if start is None else {"started_from": training_of(start)}
        save_weights(trained, target, training=facts, **before)
    print_line(f"wrote {target}, {target.stat().st_size / 1e6:.1f} MB")
    return None
