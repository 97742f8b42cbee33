"""bfloat16 on CPUs that have it: convolutions alone, the same network comes of it, and wrong gradients are refused."""

from __future__ import annotations

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from sdm.errors import SDMError
from sdm.segmentation import METHODS, Patches, SegmentationModel, Settings, train
from sdm.training.precision import check_gradients, uses_bfloat16
from tests.helpers.segmentation_cases import case

CPU, GPU = torch.device("cpu"), torch.device("cuda")
ASKED = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")
HAS = any(getattr(torch.cpu, name, lambda: False)() for name in ASKED)


def source(method: str, patch: tuple[int, int, int]) -> Patches:
    return Patches([case(0), case(1)], METHODS[method].map, patch, "cpu")


def settings(**changes) -> Settings:
    given = {"method": "head-sdf-l1", "patch": (32, 16, 16), "batch": 2, "steps": 8, "filters": 4, "seed": 3}
    return Settings(**{**given, "architecture": "unet", **changes})


class Kinds(TorchDispatchMode):
    """Kinds of numbers that convolutions were given."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: set[torch.dtype] = set()

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        if "convolution" in str(func):
            self.seen.add(args[0].dtype)
        return func(*args, **(kwargs or {}))


def test_without_a_word_a_cpu_trains_in_float32():
    with Kinds() as kinds:
        train(source("baseline", (32, 16, 16)), settings(method="baseline", steps=1))
    assert kinds.seen == {torch.float32}


@pytest.mark.skipif(not HAS, reason="this CPU has no bfloat16")
def test_convolutions_are_in_bfloat16_and_nothing_else():
    chosen = settings()
    exact = train(source(chosen.method, chosen.patch), chosen)
    fast = train(source(chosen.method, chosen.patch), chosen, bfloat16=True)
    with Kinds() as kinds:
        train(source(chosen.method, chosen.patch), settings(steps=1), bfloat16=True)
    # float32 is what the gradients are checked against.
    assert torch.bfloat16 in kinds.seen
    assert {weight.dtype for weight in fast.model.parameters()} == {torch.float32}
    assert fast.losses != exact.losses
    for (step, loss), (same, other) in zip(fast.losses, exact.losses, strict=True):
        assert step == same
        assert loss == pytest.approx(other, rel=0.05), step


@pytest.mark.skipif(not HAS, reason="this CPU has no bfloat16")
def test_it_is_the_same_each_time():
    chosen = settings(method="baseline", steps=4, dropout=0.5)
    whole = train(source("baseline", chosen.patch), chosen, bfloat16=True)
    again = train(source("baseline", chosen.patch), chosen, bfloat16=True)
    for name, value in whole.model.state_dict().items():
        assert torch.equal(value, again.model.state_dict()[name]), name


def test_a_cpu_without_it_says_so(monkeypatch):
    for name in ASKED:
        monkeypatch.setattr(torch.cpu, name, lambda: False, raising=False)
    with pytest.raises(SDMError, match="no bfloat16"):
        train(source("baseline", (32, 16, 16)), settings(method="baseline"), bfloat16=True)
    for name in ASKED:
        monkeypatch.delattr(torch.cpu, name)
    with pytest.raises(SDMError, match="cannot tell"):
        uses_bfloat16(CPU, True)
    assert not uses_bfloat16(CPU, None)


def test_a_gpu_trains_in_it_but_where_told_otherwise():
    assert uses_bfloat16(GPU, None)
    assert not uses_bfloat16(GPU, False)


@pytest.mark.parametrize("wrong", [1e9, float("nan"), 0.0])
def test_gradients_that_are_wrong_in_bfloat16_are_refused(wrong):
    """As oneDNN's are at two voxels along x: see `check_gradients`."""

    class Wrong(SegmentationModel):
        def forward(self, image):
            main, other = super().forward(image)
            return (main * wrong if torch.is_autocast_enabled("cpu") else main), other

    image = torch.randn(2, 1, 32, 16, 16)
    right, bad = (kind(METHODS["baseline"], "unet", filters=4).train() for kind in (SegmentationModel, Wrong))
    check_gradients(right, image)
    before = {name: value.clone() for name, value in bad.state_dict().items()}
    with pytest.raises(SDMError, match="wrong for patches of 32 x 16 x 16"):
        check_gradients(bad, image)
    assert right.training
    assert all(torch.equal(value, bad.state_dict()[name]) for name, value in before.items())
