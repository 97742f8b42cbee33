"""Training of the neural surrogates: on the stream, in pieces that can be resumed, within a budget."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from sdm.core.device import choose_device
from sdm.core.random import derive_seed, generator
from sdm.errors import FormatError
from sdm.io.files.atomic import try_to_write
from sdm.io.files.torch_file import load_torch, save_torch
from sdm.shapes import make_family
from sdm.stream import SDMStream
from sdm.surrogate.networks.cochlea_grid import GRID
from sdm.surrogate.networks.sdmnn_plus import SDMNNPlus
from sdm.surrogate.train.losses import dice_lost, eikonal, flips, sobolev, surface_weighted
from sdm.surrogate.train.map_buffer import Replay
from sdm.surrogate.train.recorded_step import RecordedStep
from sdm.surrogate.train.settings import RECIPES, STATIC, Settings, begin
from sdm.surrogate.train.validation import validation_batches, validation_theta
from sdm.surrogate.train.warm_start import warm_start
from sdm.training.budget import Clock
from sdm.training.checkpoints import check_settings, fitting_states
from sdm.training.curves import Curves
from sdm.training.finite_loss import check_finite
from sdm.training.precision import bfloat16, layout
from sdm.training.random_numbers import own_random_numbers
from sdm.training.schedules import linear_warmup, warmup_cosine
from sdm.training.weight_averages import exponential_average

# Steps until the learning rate is what the schedule says: Adam's first steps would undo a good beginning.
RISE = 500
# Maps that are made at a time where a step takes no fresh ones.
FILLING = 64
NO_CHECKPOINT = "is not a checkpoint of a training of a surrogate: remove it, or give another file"
CHECKPOINT_FIELDS: dict[str, Any] = {
    "settings": str,
    "model": dict[str, Tensor],
    "ema": dict[str, Tensor],
    "optimizer": dict[str, Any],
    "step": int,
    "seconds": float,
    "stream": dict[str, Any],
}


class Trainer:
    """A training that can be cut off after any step and goes on from its checkpoint.

    Args:
        settings: What to train, how.
        device: By default a GPU if there is one.
        checkpoint: File to go on from if it is there, and to write to; None for none.
        curves: Folder for curve.jsonl, and TensorBoard's events if it is installed.
        validation: How many shapes of the fixed validation set are looked at on the way.
        report: Is told in one line now and then how it goes.

    Raises:
        DeviceError: The device is not there.
        FormatError: The checkpoint is of another training, or cannot be written.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        device: torch.device | str | None = None,
        checkpoint: Path | None = None,
        curves: Path | None = None,
        validation: int = 32,
        report: Callable[[str], None] = print,
    ) -> None:
        self.settings, self.checkpoint, self._report = settings, checkpoint, report
        if checkpoint is not None:
            # The store is filled before it is written to, which may take hours.
            try_to_write(checkpoint)
        self.device = choose_device(device)
        self.family = make_family("cochlea")
        with own_random_numbers():
            torch.manual_seed(derive_seed(settings.seed, "surrogate weights"))
            self.model = begin(settings).to(self.device)
        self.ema = exponential_average(self.model, settings.ema)
        self._average = get_ema_multi_avg_fn(settings.ema)
        on_gpu = self.device.type == "cuda"
        # On a GPU a step is recorded, so that its learning rate is on the device too.
        rate = torch.zeros((), device=self.device) if on_gpu else 0.0
        self._optimizer = torch.optim.AdamW(
            _groups(self.model, rate), weight_decay=0.0, fused=on_gpu, capturable=on_gpu
        )
        self.step, spent = 0, 0.0
        static = settings.recipe == "static"
        stream = SDMStream(
            self.family,
            GRID,
            # A batch of which the 625 are a multiple, so that each is there once.
            5 if static else settings.fresh or FILLING,
            settings.seed,
            0,
            1,
            sampler=RECIPES[settings.recipe],
            device=self.device,
        )
        if checkpoint is not None and checkpoint.exists():
            spent = self._load(checkpoint, stream)
        self.clock = Clock(settings.steps, settings.budget_s, spent)
        self.replay = Replay(stream, STATIC if static else settings.store, settings.seed)
        self._fresh = 0 if static else settings.fresh
        self._curves = Curves(curves)
        theta = validation_theta(self.family)[:validation]
        self._validation = [(b.theta, b.sdm.half()) for b in validation_batches(theta, self.device)]
        if self.device.type == "cuda":
            self.model.to(memory_format=layout(use=True))  # pyright: ignore[reportCallIssue]
            torch.backends.cudnn.benchmark = True
        self._fast: Any = torch.compile(self._loss) if on_gpu else self._loss
        self._recorded: RecordedStep | None = None

    def run(self) -> nn.Module:
        """Train to the end and return the running mean of the model, on the device, in evaluation mode.

        Raises:
            SDMError: The loss, or the error that follows from it, is not finite any more; the checkpoint stays as it
                was.
        """
        settings = self.settings
        budget = settings.budget_s or float("inf")
        self.replay.fill(settings.fill_share * budget)
        self._report(f"{self.replay.count:,} maps stored after {self.clock.seconds:.1f} s")
        if self.step == 0 and settings.start is None and isinstance(self.model, SDMNNPlus):
            seconds = settings.warm_share * budget
            warm_start(self.model, self.replay, seconds=seconds, seed=settings.seed, report=self._report)
            self.ema.module.load_state_dict(self.model.state_dict())
        look, loss = 0.0, None
        while (share := self.clock.share(self.step)) < 1:
            loss = self._train(share)
            self.step += 1
            if self.clock.seconds > look:
                look = self.clock.seconds + max(5.0, 0.05 * (settings.budget_s or 0))
                self._look(loss, share)
        self._look(loss, 1.0)
        return self.ema.module.eval()

    def _train(self, share: float) -> Tensor:
        settings = self.settings
        factor = settings.rate * warmup_cosine(share) * linear_warmup(self.step + 1, RISE)
        for group in self._optimizer.param_groups:
            if isinstance(group["lr"], Tensor):
                group["lr"].fill_(factor * group["share"])
            else:
                group["lr"] = factor * group["share"]
        if self._fresh:
            self.replay.renew()
        rows = self.replay.draw(settings.batch_size, self.step, round(settings.hard * settings.batch_size))
        theta, exact = self.replay.at(rows)
        if settings.sobolev and settings.loss != "mse" and self.step % settings.sobolev_every == 0:
            random = generator(settings.seed, "surrogate directions", self.step)
            loss, lost = self._update(theta, exact, random)
        elif self.device.type == "cuda":
            self._recorded = self._recorded or RecordedStep(self._update, (theta, exact))
            loss, lost = self._recorded(theta, exact)
        else:
            loss, lost = self._update(theta, exact)
        self.replay.lost[rows] = lost
        return loss

    def _update(self, theta: Tensor, exact: Tensor, random: torch.Generator | None = None) -> tuple[Tensor, Tensor]:
        """Move the weights by a batch, with the Sobolev term if there are random numbers for it.

        Returns:
            The loss, and how much each shape (B,) loses of the Dice coefficient.
        """
        settings = self.settings
        with bfloat16(self.device, self.device.type == "cuda" and not settings.float32):
            loss, lost = self._fast(theta, exact)
        if random is not None:
            loss = loss + settings.sobolev * sobolev(self.model, self.family, theta[:4], random).sqrt()
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        self._optimizer.step()
        self._average(list(self.ema.module.parameters()), list(self.model.parameters()), None)
        return loss.detach(), lost

    def _loss(self, theta: Tensor, exact: Tensor) -> tuple[Tensor, Tensor]:
        """The loss of a batch, and how much each shape (B,) loses of the Dice coefficient."""
        settings = self.settings
        if settings.loss == "mse":
            predicted = self.model(theta)
            return nn.functional.mse_loss(predicted, exact), flips(predicted, exact).detach()
        if isinstance(self.model, SDMNNPlus):
            coarse, predicted = self.model.both(theta)
            loss = settings.coarse * (coarse.flatten(1) - self.model.coarse_of(exact)).abs().mean()
        else:
            predicted, loss = self.model(theta), 0.0
        loss = loss + surface_weighted(predicted, exact, settings.surface)
        if settings.dice:
            # The root mean square: shapes that lose much count for more.
            loss = loss + settings.dice * dice_lost(predicted, exact).square().mean().sqrt()
        lost = flips(predicted, exact)
        if settings.flips:
            loss = loss + settings.flips * lost.square().mean().sqrt()
        loss = loss + settings.eikonal * eikonal(predicted, exact) if settings.eikonal else loss
        return loss, lost.detach()

    @torch.no_grad()
    def _look(self, loss: Tensor | None, share: float) -> None:
        """Errors on a part of the validation set: say them, write them, and write the checkpoint.

        `loss` is that of the last step, None if there was none since the checkpoint.
        """
        self.ema.eval()
        errors, near = [], []
        for theta, exact in self._validation:
            error = (self.ema(theta) - exact.float()).abs()
            errors.append(error.mean())
            near.append(error[exact.abs() < 0.5].mean())
        mae, shell = float(torch.stack(errors).mean()), float(torch.stack(near).mean())
        record: dict[str, float] = {"step": self.step, "seconds": round(self.clock.seconds, 1)}
        record |= {} if loss is None else {"loss": float(loss.detach())}
        # Weights that are no numbers must take the place of good ones in no file.
        check_finite(self.step, *record.values(), mae)
        self._curves.add(record | {"mae": mae, "near": shell})
        self._report(
            f"step {self.step:,}, {self.clock.seconds:.0f} s, {100 * share:.0f} %: "
            + (f"loss {record['loss']:.4f}, " if "loss" in record else "")
            + f"validation {mae:.4f} mm, within 0.5 mm of the surface {shell:.4f} mm"
        )
        if self.checkpoint is not None:
            self._save(self.checkpoint)

    def _save(self, target: Path) -> None:
        state = {
            "settings": json.dumps(self.settings.identity()),
            "model": self.model.state_dict(),
            "ema": self.ema.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "step": self.step,
            "seconds": self.clock.seconds,
            "stream": self.replay.stream.state_dict(),
        }
        save_torch(state, target)

    def _load(self, source: Path, stream: SDMStream) -> float:
        state = load_torch(source, NO_CHECKPOINT, CHECKPOINT_FIELDS, device=self.device)
        try:
            kept = json.loads(state["settings"])
        except ValueError as error:
            raise FormatError(f"{source} {NO_CHECKPOINT}") from error
        check_settings(kept, self.settings, source)
        with fitting_states(source, NO_CHECKPOINT):
            self.model.load_state_dict(state["model"])
            self.ema.load_state_dict(state["ema"])
            self._optimizer.load_state_dict(state["optimizer"])
            stream.load_state_dict(state["stream"])
        self.step = state["step"]
        return float(state["seconds"])


def _groups(model: nn.Module, rate: Tensor | float) -> list[dict[str, Any]]:
    """Parameters with their learning rate and its share: what a decomposition has set moves slowly."""
    slow = [p for name, p in model.named_parameters() if name in ("modes", "mean", "place")]
    quick = [p for name, p in model.named_parameters() if name not in ("modes", "mean", "place")]
    groups = [{"params": quick, "share": 1.0}] + ([{"params": slow, "share": 0.1}] if slow else [])
    return [{**group, "lr": rate.clone() if isinstance(rate, Tensor) else rate} for group in groups]
