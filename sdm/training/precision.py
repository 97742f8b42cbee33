"""bfloat16: always on a GPU, on request on CPUs that have it, and there only where its gradients are right."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import cast

import torch
from torch import Tensor, nn

from sdm.errors import SDMError

# Largest difference of a weight's gradient from that in float32, as a share of it. Right ones stay below a fifth.
LARGEST_DIFFERENCE = 0.5


def uses_bfloat16(device: torch.device, wanted: bool | None) -> bool:
    """True if a training is in bfloat16: as wanted, or, if nothing is said, on a GPU.

    Raises:
        SDMError: A CPU has no instructions for it: it would take more time for it than for float32.
    """
    if wanted and device.type == "cpu" and not cpu_has_bfloat16():
        raise SDMError("this CPU has no bfloat16 (AVX512-BF16 or AMX), or this torch cannot tell: train in float32")
    return device.type == "cuda" if wanted is None else wanted


def bfloat16(device: torch.device, use: bool) -> AbstractContextManager[object]:
    """Autocast: convolutions and linear layers in bfloat16 if `use`; weights, sums and losses stay float32."""
    return torch.autocast(device.type, torch.bfloat16, enabled=use)


def full_precision(x: Tensor) -> AbstractContextManager[object]:
    """Autocast off on x's device: bfloat16 would round millimetres to hundredths."""
    if not torch.is_autocast_enabled(x.device.type):
        return nullcontext()
    return torch.autocast(x.device.type, enabled=False)


def layout(use: bool) -> torch.memory_format:
    """Memory format of networks and images (B,C,x,y,z): channels side by side, which bfloat16 likes."""
    return torch.channels_last_3d if use else torch.contiguous_format


def check_gradients(model: nn.Module, image: Tensor) -> None:
    """Refuse a network and images whose gradients in bfloat16 are not those in float32.

    oneDNN, which torch's CPU convolutions are made by, adds what lies in memory to the gradients of 3^3 kernels where
    an image has two voxels along its first axis (torch 2.13, AVX512-BF16): a training is random, or ends in NaN.

    Args:
        model: The network, from an image to a tensor or a tuple of tensors and None; left as it was.
        image: As in a step, (B,C,x,y,z).

    Raises:
        SDMError: They differ.
    """
    named = [(name, weight) for name, weight in model.named_parameters() if weight.requires_grad]
    weights = [weight for _, weight in named]
    was = model.training
    # No dropout, and statistics that do not move: only the precision differs.
    model.eval()
    found = []
    for use in (False, True):
        with bfloat16(image.device, use):
            answer = model(image)
        outputs = cast("tuple[Tensor | None, ...]", answer if isinstance(answer, tuple) else (answer,))
        loss = torch.stack([o.float().square().mean() for o in outputs if o is not None]).sum()
        found.append(torch.autograd.grad(loss, weights, allow_unused=True))
    model.train(was)
    for (name, _), exact, fast in zip(named, *found, strict=True):
        # Not `>`: a gradient may be NaN.
        if exact is not None and fast is not None and not (fast - exact).norm() <= LARGEST_DIFFERENCE * exact.norm():
            size = " x ".join(str(n) for n in image.shape[2:])
            raise SDMError(
                f"torch's gradient of {name} in bfloat16 is wrong for patches of {size}: train in float32, or choose "
                "a patch that is larger along x"
            )


def cpu_has_bfloat16() -> bool:
    """True if this processor multiplies bfloat16 by instructions of its own (AVX512-BF16 or AMX)."""
    # Not public, and not in every version.
    asked = (getattr(torch.cpu, name, None) for name in ("_is_avx512_bf16_supported", "_is_amx_tile_supported"))
    return any(ask() for ask in asked if ask is not None)
