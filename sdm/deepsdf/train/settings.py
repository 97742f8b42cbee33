"""What a DeepSDF is and how it is trained: the published settings and ours."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from sdm.errors import SDMError


@dataclass(frozen=True, kw_only=True)
class Settings:
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
        # JSON and torch's files give lists back.
        object.__setattr__(self, "grids", tuple((int(r), int(c)) for r, c in self.grids))
        _check(self)

    @property
    def code_size(self) -> int:
        """Numbers of a code: those for the whole shape, then grid by grid."""
        return self.global_size + sum(channels * resolution**3 for resolution, channels in self.grids)

    def as_dict(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)


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


def _check(settings: Settings) -> None:
    for name, choices in (
        ("variant", ("published", "local")),
        ("schedule", ("halving", "cosine")),
        ("precision", ("bf16", "tf32", "float32")),
    ):
        if getattr(settings, name) not in choices:
            raise SDMError(f"the {name} {getattr(settings, name)!r} is unknown; use one of {', '.join(choices)}")
    for name in ("width", "layers", "global_size", "shapes", "points", "epochs", "clamp", "decoder_rate", "code_rate"):
        if not getattr(settings, name) > 0:
            raise SDMError(f"{name} is {getattr(settings, name)}; it must be positive")
    if settings.variant == "published" and settings.layers < 5:
        raise SDMError("the published network joins code and point before its fifth layer: 5 layers or more are needed")
    if settings.variant == "published" and settings.width <= settings.global_size + 3:
        least = settings.global_size + 4
        raise SDMError(f"a width of {settings.width} has no room for code and point: {least} or more are needed")
    if any(resolution < 2 or channels < 1 for resolution, channels in settings.grids):
        raise SDMError(f"the grids {settings.grids} are pairs of a resolution of at least 2 and channels of at least 1")
