"""Settings of DeepSDF trainings: the published ones and ours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sdm.errors import SDMError
from sdm.training.schedules import cosine_decay, linear_warmup
from sdm.training.training_settings import TrainingSettings, check_choice, check_counts, check_number

# Share of a cosine schedule in which the rate rises, and where it ends.
RISE = 0.02
END = 0.01


@dataclass(frozen=True, kw_only=True)
class Settings(TrainingSettings):
    """Everything that decides a training but the shapes; lengths are in unit-sphere radii.

    Args:
        variant: "published" (one code for the whole shape, J. Park et al., CVPR 2019) or "local" (a code for the
            whole shape and codes on coarse grids of its box, interpolated).
        width: Neurons of a hidden layer.
        layers: Hidden layers.
        global_size: Numbers of the code for the whole shape.
        grids: Resolution and channels of each grid of codes ("local").
        frequencies: Octaves of the positional encoding ("local").
        dropout: Probability in every hidden layer ("published").
        clamp: Distance up to which values matter; the "local" variant's loss fades with the distance instead.
        code_deviation: Of each number of a code at the start.
        code_bound: Largest length of a code; None for no bound.
        code_weight: Weight of the codes' squared lengths, rising to this over the first `code_rise` of the training.
        code_rise: Share of the training.
        shapes: Shapes of a batch, over all ranks.
        points: Samples of each.
        epochs: How often every shape is seen; a budget of seconds may end the training before.
        decoder_rate: Adam's learning rate for the network at the start.
        code_rate: For the codes.
        schedule: "halving" (after each quarter of the training) or "cosine" (to a hundredth, after a short rise).
        precision: "bf16" or "tf32" on a GPU; float32 on a CPU.
        seed: Of weights, codes, order and samples.
    """

    variant: str = "published"
    width: int = 512
    layers: int = 8
    global_size: int = 256
    grids: tuple[tuple[int, int], ...] = ()
    frequencies: int = 0
    dropout: float = 0.2
    clamp: float = 0.1
    code_deviation: float = 1 / 16
    code_bound: float | None = 1.0
    code_weight: float = 1e-4
    code_rise: float = 0.05
    shapes: int = 64
    points: int = 16384
    epochs: int = 2001
    decoder_rate: float = 5e-4
    code_rate: float = 1e-3
    schedule: str = "halving"
    precision: str = "bf16"
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "grids", tuple((int(r), int(c)) for r, c in self.grids))
        super().__post_init__()

    def check(self) -> None:
        """Refuse settings that cannot be trained: see `TrainingSettings.check`."""
        check_choice("variant", self.variant, VARIANTS)
        check_choice("schedule", self.schedule, ("halving", "cosine"))
        check_choice("precision", self.precision, ("bf16", "tf32", "float32"))
        check_counts(**{name: getattr(self, name) for name in ("width", "layers", "global_size", "points", "epochs")})
        check_counts(batch_size=self.shapes)
        for name in ("clamp", "decoder_rate", "code_rate"):
            check_number(name, getattr(self, name), above=0)
        if self.variant == "published" and self.layers < 5:
            raise SDMError(
                "the published network joins code and point before its fifth layer: 5 layers or more are needed"
            )
        if self.variant == "published" and self.width <= self.global_size + 3:
            least = self.global_size + 4
            raise SDMError(f"a width of {self.width} has no room for code and point: {least} or more are needed")
        if any(resolution < 2 or channels < 1 for resolution, channels in self.grids):
            raise SDMError(f"the grids {self.grids} are pairs of a resolution of at least 2 and channels of at least 1")

    @property
    def code_size(self) -> int:
        """Numbers of a code: those for the whole shape, then grid by grid."""
        return self.global_size + sum(channels * resolution**3 for resolution, channels in self.grids)

    def rate_factor(self, done: float) -> float:
        """Factor of the learning rates when a share `done` of the training is over."""
        if self.schedule == "halving":
            return 0.5 ** int(4 * done)
        return linear_warmup(done + 1e-3, RISE) * cosine_decay(done, floor=END)

    def code_weight_at(self, done: float) -> float:
        """Weight of the codes' squared lengths when a share `done` of the training is over."""
        return self.code_weight * linear_warmup(done, self.code_rise)


def published(**changes: Any) -> Settings:
    """8 layers of 512, a code of 256, dropout, clamped L1, halved rates: the paper's settings."""
    return Settings(**changes)


def local(**changes: Any) -> Settings:
    """Ours: codes of the whole shape and on grids of 4^3 and 12^3, a small network, no dropout, a fading loss.

    Unseen shapes are put together from parts that were seen, so a code is found for shapes unlike any of a small set.
    """
    ours: dict[str, Any] = {
        "variant": "local",
        "width": 192,
        "layers": 4,
        "global_size": 64,
        "grids": ((4, 16), (12, 8)),
        "frequencies": 4,
        "dropout": 0.0,
        "code_deviation": 0.01,
        "code_bound": None,
        "code_weight": 1e-6,
        "shapes": 32,
        "points": 4096,
        "epochs": 1_000_000,
        "decoder_rate": 3e-3,
        "code_rate": 2e-2,
        "schedule": "cosine",
        "precision": "tf32",
    }
    return Settings(**(ours | changes))


VARIANTS = {"published": published, "local": local}
