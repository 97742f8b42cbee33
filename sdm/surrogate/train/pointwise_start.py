"""SDMNN+ with features of single blocks, from a trained one without."""

from __future__ import annotations

import torch

from sdm.errors import SDMError
from sdm.surrogate.networks.sdmnn_plus import SDMNNPlus


@torch.no_grad()
def with_pointwise(model: SDMNNPlus, modes: int, pointwise: int) -> SDMNNPlus:
    """A network of the second kind (`pointwise` features of single blocks) that begins near one of the first.

    It has the first of the other's modes, and its last layer takes both the sum's parts as it took the sum. What it
    cannot have are what training added to the interpolation, and the last layer's bias: of the shipped network of
    208 modes maps are then a hundredth of a millimetre off, which some thousand steps of training take away.

    Args:
        model: Of the first kind.
        modes: How many of its modes are kept, at most as many as it has.
        pointwise: Features of single blocks; their weights are random, and nothing takes them yet.

    Raises:
        SDMError: More modes than it has.
    """
    config = model.config
    if modes > config["modes"]:
        raise SDMError(f"{modes} modes of a network that has {config['modes']} were requested; give at most these")
    new = SDMNNPlus(**config | {"modes": modes, "pointwise": pointwise})
    state, channels = new.state_dict(), config["channels"]
    for name, value in model.state_dict().items():
        if name in ("modes", "scale", "coefficients.weight", "coefficients.bias"):
            state[name] = value[:modes].clone()
        elif name == "last.weight":
            for part in state[name].split(channels, 1)[: config["depth"] + 1]:
                part.copy_(value)
        elif name in state:
            state[name] = value.clone()
    new.load_state_dict(state)
    return new
