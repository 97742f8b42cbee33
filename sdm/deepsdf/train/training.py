"""Training of an auto-decoder: on one device or under torchrun, by steps or by the clock, and on after a kill."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from sdm.core.device import choose_device
from sdm.core.random import derive_seed
from sdm.deepsdf.networks.auto_decoder import AutoDecoder
from sdm.deepsdf.samples import SampleSource, UnitSphere
from sdm.deepsdf.train import checkpoint
from sdm.deepsdf.train.batches import Batches
from sdm.deepsdf.train.checkpoint import CHECKPOINT
from sdm.deepsdf.train.settings import Settings
from sdm.errors import FormatError, SDMError
from sdm.runtime.prefetch import prefetch
from sdm.runtime.torch_warp import to_device
from sdm.training.budget import Clock, Interval
from sdm.training.checkpoints import check_settings, fitting_states
from sdm.training.finite_loss import check_finite
from sdm.training.precision import bfloat16
from sdm.training.random_numbers import own_random_numbers

# Steps that the device may be behind before the loss is read and the clock is looked at.
LOOK_EVERY = 10


def train(
    source: SampleSource,
    settings: Settings,
    folder: str | Path,
    *,
    names: Sequence[str],
    spheres: Sequence[UnitSphere],
    budget_s: float | None = None,
    device: str | torch.device | None = None,
    resume: bool = False,
    checkpoint_every_s: float = 60.0,
    compile_network: bool | None = None,
    progress: Callable[[int, int, float], None] | None = None,
) -> Path:
    """Train, and write `model.pt` into a folder.

    Args:
        source: Samples of each shape; on the same device.
        settings: What to train and how.
        folder: For the checkpoint and the model; made if it is not there.
        names: The shapes' names.
        spheres: Their normalisations.
        budget_s: Seconds of training at most, over all restarts, compiling apart. The schedule fits itself to what ends
            first.
        device: Where to train; by default a GPU if there is one.
        resume: Go on from the folder's checkpoint if there is one. Else one of an unfinished training is refused.
        checkpoint_every_s: Seconds between checkpoints.
        compile_network: By torch.compile; by default on GPUs.
        progress: Called now and then with the step, the number of steps, and the loss.

    Returns:
        The model's file.

    Raises:
        FormatError: The checkpoint is of other settings or shapes, or of an unfinished training that is not resumed.
        SDMError: The loss is not finite any more, or the budget is not positive.

    Under an initialised process group the shapes of a batch are shared by the ranks, and rank 0 writes.
    """
    run = Trainer(source, settings, folder, names=names, spheres=spheres, device=device)
    if resume:
        run.restore()
    else:
        checkpoint.refuse_unfinished_in(run.folder)
    run.prepare(run.device.type == "cuda" if compile_network is None else compile_network)
    with training_state(settings, run.device):
        run.go(budget_s, checkpoint_every_s, progress)
    return run.finish()


class Trainer:
    """One training, step by step: what `train` runs, and what benchmarks time. The arguments are those of `train`."""

    def __init__(
        self,
        source: SampleSource,
        settings: Settings,
        folder: str | Path,
        *,
        names: Sequence[str],
        spheres: Sequence[UnitSphere],
        device: str | torch.device | None = None,
    ) -> None:
        if not len(source) == len(names) == len(spheres):
            raise SDMError(f"{len(source)} shapes, {len(names)} names and {len(spheres)} spheres do not fit together")
        self.source, self.settings, self.folder = source, settings, Path(folder)
        self.names, self.spheres = list(names), list(spheres)
        self.device = choose_device(device)
        shared = torch.distributed.is_available() and torch.distributed.is_initialized()
        self.rank = torch.distributed.get_rank() if shared else 0
        self.world = torch.distributed.get_world_size() if shared else 1
        self.batches = Batches(len(source), settings.shapes, settings.seed, self.rank, self.world)
        self.steps = settings.epochs * self.batches.per_epoch
        self.model = AutoDecoder(settings, len(source)).to(self.device)
        groups = [
            {"params": self.model.decoder.parameters(), "base": settings.decoder_rate},
            {"params": [self.model.codes], "base": settings.code_rate},
        ]
        self.optimizer = torch.optim.Adam(groups, lr=settings.decoder_rate)
        self.step, self.seconds = 0, 0.0
        self.history: list[tuple[int, float, float]] = []
        self._network: Any = self.model
        self._compiled = False

    def prepare(self, compile_network: bool) -> None:
        """Share the network among the ranks, and compile it."""
        network: nn.Module = self.model
        if self.world > 1:
            ids = [self.device.index] if self.device.type == "cuda" else None
            network = DistributedDataParallel(network, device_ids=ids)
        self._network = torch.compile(network) if compile_network else network
        self._compiled = compile_network

    def restore(self) -> None:
        """Go back to the folder's checkpoint, if there is one."""
        folder = self.folder / CHECKPOINT
        if not folder.exists():
            return
        saved = checkpoint.read_model(folder, self.device)
        check_settings(saved["settings"], self.settings, folder)
        # Not the same bit for bit: processors differ in the last one.
        if not (saved["names"] == self.names and np.allclose(saved["spheres"], self._spheres(), rtol=1e-6)):
            raise FormatError(f"{folder} was begun with other shapes; go on with those, or train in another folder")
        # Adam counts its steps on the host; the rest goes where the weights are by itself.
        more = checkpoint.read_optimizer(folder)
        with fitting_states(folder, "is no checkpoint of these settings"):
            self.model.load_state_dict(saved["state"])
            self.optimizer.load_state_dict(more["state"])
        self.step, self.seconds, self.history = saved["step"], saved["seconds"], saved["history"]

    def go(self, budget_s: float | None, every_s: float, progress: Callable[[int, int, float], None] | None) -> None:
        """Train to the end of the steps or of the budget, which does not count the time to compile."""
        if self._compiled:
            self._loss(*self.draw(self.step), 0.0)[1].backward()
            self.optimizer.zero_grad(set_to_none=True)
        clock, pause = Clock(self.steps, budget_s, self.seconds), Interval(every_s)
        done = self._done(clock)
        batches = self.batches_ahead()
        while done < 1:
            loss = self.update(*next(batches), done)
            self.step += 1
            if self.step % LOOK_EVERY and self.step < self.steps:
                continue
            value = float(loss)
            check_finite(self.step, value)
            done = self._done(clock)
            # Read after that, so that a training whose time is over has used all of it.
            self.seconds = clock.seconds
            self.history.append((self.step, round(self.seconds, 3), value))
            if progress is not None and self.rank == 0:
                progress(self.step, self.steps, value)
            if done < 1 and pause.is_over():
                self._save()

    def finish(self) -> Path:
        """Write the checkpoint and the model."""
        self._save()
        path = self.folder / checkpoint.MODEL
        if self.rank == 0:
            checkpoint.write(self._content(), path)
        if self.world > 1:
            # Nobody reads the model before it is there.
            torch.distributed.barrier()
        return path

    def draw(self, step: int) -> tuple[Tensor, Tensor, Tensor]:
        """Shapes (B,), points (B,N,3) and values (B,N) of a step."""
        shapes = to_device(self.batches[step], self.device)
        points, values = self.source.sample(shapes, self.settings.points, seed=self.settings.seed, step=step)
        return shapes, points, values

    def batches_ahead(self) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Batches of this step and those to come, on a GPU drawn beside the step before, which leaves it room."""
        steps = iter(range(self.step, self.steps))
        drawn = prefetch(lambda several: [self.draw(step) for step in several], steps, self.device, 1)
        return (batch for _, batch in drawn)

    def update(self, shapes: Tensor, points: Tensor, values: Tensor, done: float = 0.0) -> Tensor:
        """One step of Adam when a share `done` of the training is over; gives the loss of the data."""
        for group in self.optimizer.param_groups:
            group["lr"] = group["base"] * self.settings.rate_factor(done)
        loss, total = self._loss(shapes, points, values, done)
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()
        self.optimizer.step()
        return loss.detach()

    def _loss(self, shapes: Tensor, points: Tensor, values: Tensor, done: float) -> tuple[Tensor, Tensor]:
        """The loss of the data, and with that of the codes."""
        # Dropout draws from torch's own generator: started anew, so that a training that goes on goes on the same.
        torch.manual_seed(derive_seed(self.settings.seed, "DeepSDF dropout", self.step, self.rank))
        self.model.train()
        with bfloat16(self.device, self.settings.precision == "bf16" and self.device.type == "cuda"):
            loss, length = self._network(shapes, points, values)
        return loss, loss + self.settings.code_weight_at(done) * length

    def _done(self, clock: Clock) -> float:
        done = clock.share(self.step)
        if self.world == 1:
            return done
        # Clocks differ, rates must not.
        shared = torch.tensor([done], dtype=torch.float64, device=self.device)
        torch.distributed.broadcast(shared, 0)
        return float(shared)

    def _spheres(self) -> list[list[float]]:
        return [[*s.centre, s.radius] for s in self.spheres]

    def _content(self) -> dict[str, Any]:
        return {
            "settings": self.settings.record(),
            "names": self.names,
            "spheres": self._spheres(),
            "state": {name: value.detach().cpu() for name, value in self.model.state_dict().items()},
            "step": self.step,
            "seconds": self.seconds,
            "history": self.history[:: max(1, len(self.history) // 1000)],
        }

    def _save(self) -> None:
        if self.rank == 0:
            self.folder.mkdir(parents=True, exist_ok=True)
            content = {"state": self.optimizer.state_dict(), "step": self.step}
            checkpoint.write_both(self._content(), content, self.folder / CHECKPOINT)


@contextmanager
def training_state(settings: Settings, device: torch.device) -> Iterator[None]:
    """Train within the block, and leave torch's generators and its precision of matrices as they were."""
    precision = torch.get_float32_matmul_precision()
    with own_random_numbers(device):
        try:
            torch.set_float32_matmul_precision("highest" if settings.precision == "float32" else "high")
            yield
        finally:
            torch.set_float32_matmul_precision(precision)
