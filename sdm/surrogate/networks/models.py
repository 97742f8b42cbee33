"""Registry of surrogates by name."""

from __future__ import annotations

from typing import Any

from torch import nn

from sdm.errors import SDMError
from sdm.surrogate.networks.pod_chebyshev import PODChebyshev
from sdm.surrogate.networks.sdmnn import SDMNN
from sdm.surrogate.networks.sdmnn_plus import SDMNNPlus

MODELS: dict[str, type[nn.Module]] = {"sdmnn": SDMNN, "sdmnn-plus": SDMNNPlus, "pod-chebyshev": PODChebyshev}


def build(name: str, **config: Any) -> nn.Module:
    """A surrogate by name, untrained.

    Raises:
        SDMError: There is none of that name.
    """
    if not isinstance(name, str) or name not in MODELS:
        raise SDMError(f"there is no surrogate called {name!r}; use {', '.join(MODELS)}")
    return MODELS[name](**config)


def name_of(model: nn.Module) -> str:
    """The name of a surrogate."""
    return next(name for name, kind in MODELS.items() if type(model) is kind)
