"""Torch operators: `torch.ops.sdm.*`, registered so that eager calls load no compiler.

`torch.library.custom_op` does the same, but its first call imports `torch._dynamo`, which takes longer than a small
map. Here the compiler is told to leave an implementation alone once it is there to be told.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch._C import _len_torch_dispatch_stack
from torch._C._functorch import maybe_current_level
from torch.library import Library

F = TypeVar("F", bound=Callable[..., Any])

_LIBRARY = Library("sdm", "FRAGMENT")
_BACKENDS = "CPU", "CUDA"


def define(name: str, fake: Callable[..., Any]) -> Callable[[F], F]:
    """Register the decorated function as the operator `sdm::<name>`, on CPUs and GPUs.

    Args:
        name: The operator's name.
        fake: Takes the same arguments; results of the same shapes, types and devices, without values.

    The schema is read from the function's annotations. The function writes into none of its arguments, and returns no
    memory of theirs. It is returned as it is: call `torch.ops.sdm.<name>` for what autograd and compilers see.
    """

    def register(function: F) -> F:
        _LIBRARY.define(name + torch.library.infer_schema(function, mutates_args=()))
        implementation = _hidden_from_compilers(function)
        for backend in _BACKENDS:
            _LIBRARY.impl(name, implementation, backend)
        torch.library.register_fake(f"sdm::{name}", fake, lib=_LIBRARY)
        return function

    return register


def differentiate(name: str, backward: Callable[..., Any], setup_context: Callable[..., None]) -> None:
    """Give the operator `sdm::<name>` a gradient, as `torch.library.register_autograd` does."""
    torch.library.register_autograd(f"sdm::{name}", backward, setup_context=setup_context, lib=_LIBRARY)


# Without the looks for them at each call; the compiler knows the function itself. What else traces has a mode, or
# tensors of its own kind.
is_compiling = torch.compiler.is_dynamo_compiling
_PLAIN = (Tensor, torch.nn.Parameter)


def is_eager(*tensors: Tensor) -> bool:
    """True if nobody watches what happens to these tensors: no gradients, no compiler, no transform, no mode.

    Then an operator's implementation may be called directly.
    """
    if is_compiling() or _len_torch_dispatch_stack() > 0 or maybe_current_level() is not None:
        return False
    # A generator takes as long as all before.
    for tensor in tensors:
        # Subclasses only look like tensors.
        if type(tensor) not in _PLAIN or (tensor.requires_grad and torch.is_grad_enabled()):
            return False
    return True


def are_eager(tensors: Sequence[Tensor]) -> list[bool]:
    """`is_eager` of each of many tensors."""
    if not is_eager():
        return [False] * len(tensors)
    gradients = torch.is_grad_enabled()
    return [type(tensor) in _PLAIN and not (gradients and tensor.requires_grad) for tensor in tensors]


def _hidden_from_compilers(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, of which `torch.compile` traces nothing."""
    hidden: list[Callable[..., Any]] = []

    @wraps(function)
    def run(*args: Any, **named: Any) -> Any:
        if not hidden and "torch._dynamo" in sys.modules:
            hidden.append(torch.compiler.disable(function))
        return (hidden[0] if hidden else function)(*args, **named)

    return run
