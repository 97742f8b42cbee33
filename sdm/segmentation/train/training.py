"""Training loop of segmentation networks: it resumes where it was, and stops when its time is over."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from sdm.core.random import derive_seed
from sdm.errors import SDMError
from sdm.io.files.torch_file import load_torch, save_torch
from sdm.segmentation.data.augment import Augment
from sdm.segmentation.data.patches import Patch
from sdm.segmentation.networks.model import SegmentationModel
from sdm.segmentation.train.objective import Step, objective
from sdm.segmentation.train.settings import Settings
from sdm.training.budget import Clock, Interval
from sdm.training.checkpoints import check_settings, fitting_states
from sdm.training.finite_loss import check_finite
from sdm.training.precision import bfloat16 as autocast
from sdm.training.precision import check_gradients, layout, uses_bfloat16
from sdm.training.random_numbers import own_random_numbers
from sdm.training.weight_averages import LateAverage

LARGEST_GRADIENT = 1.0
SAVE_EVERY_S = 120.0
# Losses that a log keeps.
POINTS = 20
NO_CHECKPOINT = "is not a checkpoint of a training: remove it to begin anew"
CHECKPOINT_FIELDS: dict[str, Any] = {
    "settings": dict[str, Any],
    "step": int,
    "seconds": float,
    "losses": list[tuple[int, float]],
    "model": dict[str, Tensor],
    "optimizer": dict[str, Any],
    "average": list[Tensor] | None,
    "random": Tensor,
    "random_device": Tensor | None,
}


class Source(Protocol):
    """Source of batches: `Patches`, or anything else that makes them on a device."""

    device: torch.device
    spacing: tuple[float, float, float]
    # True if images come with the positions of their voxels.
    position: bool
    # Edge of a batch's voxels in voxels of the cases.
    coarsen: int

    def batch(self, count: int, *, seed: int, step: int, augment: Augment) -> Patch:
        """A batch: a pure function of its arguments."""
        ...


@dataclass
class Training:
    """A training, finished or not.

    Args:
        model: The network; once the training is finished with its averaged weights, if the settings say so.
        step: Steps done.
        seconds: Spent in them, over all sessions.
        losses: (step, loss) now and then.
        average: Of the weights so far.
    """

    model: SegmentationModel
    step: int = 0
    seconds: float = 0.0
    losses: list[tuple[int, float]] = field(default_factory=list)
    average: LateAverage | None = None


def train(
    patches: Source,
    settings: Settings,
    *,
    checkpoint: Path | None = None,
    deadline: float | None = None,
    compiled: bool = False,
    bfloat16: bool | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Training:
    """Train a network, on the patches' device.

    Args:
        patches: Of the training cases, with the map of the settings' method, and positions if the settings say so.
        settings: What to do.
        checkpoint: File that keeps an unfinished training; if it is there, and of the same settings, it is continued.
            It is removed by none but the caller.
        deadline: Value of `time.monotonic()` at which to stop, finished or not.
        compiled: Whether to compile the network: worth it for some hundred steps on a GPU.
        bfloat16: Whether convolutions are in bfloat16 instead of float32; None: on a GPU. A CPU that has it does twice
            as many steps in the same time.
        progress: Called with steps done and in all.

    Returns:
        The training; finished if its `step` is the settings' `steps`.

    Raises:
        FormatError: The checkpoint is of another training.
        SDMError: The loss is not finite any more, patches and settings differ in positions or in coarse voxels, or a
            CPU has no bfloat16, or a wrong one for this patch (`precision.check_gradients`).
    """
    for name in ("position", "coarsen"):
        wanted, given = getattr(settings, name), getattr(patches, name)
        if wanted != given:
            raise SDMError(f"the settings have {name}={wanted}, the patches {given}: give both the same")
    device = patches.device
    reduce = uses_bfloat16(device, bfloat16)
    with own_random_numbers(device):
        torch.manual_seed(derive_seed(settings.seed, "segmentation weights and dropout"))
        model = settings.network().to(device)
        model = model.to(memory_format=layout(reduce))  # type: ignore[call-overload]
        optimizer = _optimizer(model, settings)
        training = Training(model, average=LateAverage(model, settings.average) if settings.average else None)
        if checkpoint is not None and checkpoint.is_file():
            _restore(checkpoint, training, optimizer, settings, device)
        if reduce and device.type == "cpu":
            check_gradients(model, _batch(patches, settings, training.step).image)
        model.train()
        clock, pause = Clock(settings.steps, spent_s=training.seconds), Interval(SAVE_EVERY_S)
        with _compiled(model) if compiled else nullcontext():
            while training.step < settings.steps and (deadline is None or time.monotonic() < deadline):
                _step(training, optimizer, patches, settings, reduce)
                progress(training.step, settings.steps)
                training.seconds = clock.seconds
                if checkpoint is not None and pause.is_over():
                    _save(checkpoint, training, optimizer, settings, device)
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        training.seconds = clock.seconds
        if checkpoint is not None and training.step < settings.steps:
            _save(checkpoint, training, optimizer, settings, device)
    if training.average is not None and training.step == settings.steps:
        training.average.give(model)
    model.eval()
    return training


def _step(
    training: Training, optimizer: torch.optim.Optimizer, patches: Source, settings: Settings, reduce: bool
) -> None:
    step = training.step
    patch = _batch(patches, settings, step)
    for group in optimizer.param_groups:
        group["lr"] = settings.learning_rate_at(step)
    image = patch.image.to(memory_format=layout(reduce))
    with autocast(image.device, reduce):
        main, auxiliary = training.model(image)
    done = step / settings.steps
    state = Step(training.model.method, main, patch.label, patch.map, done, patches.spacing)
    loss = objective(state, auxiliary)
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    nn.utils.clip_grad_norm_(training.model.parameters(), LARGEST_GRADIENT)
    optimizer.step()
    training.step += 1
    if training.average is not None:
        training.average.update(training.model, training.step)
    if training.step % max(1, settings.steps // POINTS) == 0 or training.step == settings.steps:
        value = float(loss.detach())
        check_finite(training.step, value)
        training.losses.append((training.step, round(value, 6)))


def _batch(patches: Source, settings: Settings, step: int) -> Patch:
    return patches.batch(settings.batch, seed=settings.seed, step=step, augment=settings.augment)


@contextmanager
def _compiled(model: SegmentationModel) -> Iterator[None]:
    """Encoder and decoders compiled: code that methods share, so that a process with many trainings compiles once."""
    model.decoded = torch.compile(model.decoded, dynamic=False)
    try:
        yield
    finally:
        del model.decoded


def _optimizer(model: nn.Module, settings: Settings) -> torch.optim.Optimizer:
    rate, decay = settings.learning_rate, settings.weight_decay
    if settings.optimizer == "sgd":
        return torch.optim.SGD(model.parameters(), rate, momentum=0.9, weight_decay=decay, nesterov=True)
    return torch.optim.AdamW(model.parameters(), rate, weight_decay=decay)


def _save(
    path: Path, training: Training, optimizer: torch.optim.Optimizer, settings: Settings, device: torch.device
) -> None:
    state = {
        "settings": settings.record(),
        "step": training.step,
        "seconds": training.seconds,
        "losses": [list(point) for point in training.losses],
        "model": training.model.state_dict(),
        "optimizer": optimizer.state_dict(),
        "average": None if training.average is None else training.average.values,
        "random": torch.get_rng_state(),
        "random_device": torch.cuda.get_rng_state(device) if device.type == "cuda" else None,
    }
    save_torch(state, path)


def _restore(
    path: Path, training: Training, optimizer: torch.optim.Optimizer, settings: Settings, device: torch.device
) -> None:
    state = load_torch(path, NO_CHECKPOINT, CHECKPOINT_FIELDS)
    check_settings(state["settings"], settings, path)
    with fitting_states(path, NO_CHECKPOINT):
        training.model.load_state_dict(state["model"])
        optimizer.load_state_dict(state["optimizer"])
        if training.average is not None:
            training.average.restore(state["average"])
    training.step, training.seconds = state["step"], state["seconds"]
    training.losses = [(int(a), float(b)) for a, b in state["losses"]]
    torch.set_rng_state(state["random"])
    if device.type == "cuda" and state["random_device"] is not None:
        torch.cuda.set_rng_state(state["random_device"], device)
