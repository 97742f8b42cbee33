"""Shapes and dtypes of tensors checked in the tests: jaxtyping's annotations, by beartype, as modules are imported.

In a module of the package that imports jaxtyping, the tensors that go in and out of its functions and methods, and the
fields of its dataclasses, must be as annotated. Other annotations are left to pyright. jaxtyping's own import hook
wraps every function of a module, which torch.compile cannot trace through.
"""

from __future__ import annotations

import dataclasses
import functools
import re
import sys
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import jaxtyping
import torch
from beartype import BeartypeConf, beartype
from beartype.door import die_if_unbearable

ARRAY = re.compile(r"\b(?:Shaped|Bool|Num|Real|Inexact|Complex|Float|Int|Integer|UInt)\d*\[")
_check = beartype(conf=BeartypeConf(is_pep484_tower=True))


def install(root: Path) -> None:
    """Check the modules of `sdm` that import jaxtyping; to be called before any of them is imported."""
    modules = {
        ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
        for path in (root / "sdm").rglob("*.py")
        if "\nfrom jaxtyping import" in path.read_text(encoding="utf-8")
    }
    sys.meta_path.insert(0, _Finder(modules))


class _Finder(MetaPathFinder):
    def __init__(self, modules: set[str]) -> None:
        self._modules = modules

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(fullname, path, target) if fullname in self._modules else None
        if spec is not None and spec.origin is not None:
            spec.loader = _Loader(fullname, spec.origin)
        return spec


class _Loader(SourceFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        _check_members(module, module.__name__)


def _check_members(owner: Any, module: str) -> None:
    for name, member in list(vars(owner).items()):
        if name == "__init__" and dataclasses.is_dataclass(owner):
            continue
        if isinstance(member, FunctionType) and member.__module__ == module:
            setattr(owner, name, _checked(member))
        elif isinstance(member, staticmethod | classmethod):
            setattr(owner, name, type(member)(_checked(member.__func__)))
        elif isinstance(member, property) and member.fget is not None:
            setattr(owner, name, property(_checked(member.fget), member.fset, member.fdel, member.__doc__))
        elif isinstance(member, type) and member.__module__ == module:
            _check_members(member, module)
    if isinstance(owner, type) and dataclasses.is_dataclass(owner):
        _check_fields(owner)


def _checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` with its arrays checked, itself if it has none."""
    if not _arrays(function):
        return function
    slow = jaxtyping.jaxtyped(function, typechecker=_check_arrays)

    @functools.wraps(function)
    def checked(*args: Any, **given: Any) -> Any:
        return function(*args, **given) if torch.compiler.is_compiling() else slow(*args, **given)

    return checked


def _check_arrays(function: Callable[..., Any]) -> Callable[..., Any]:
    function.__annotations__ = {
        name: hint for name, hint in function.__annotations__.items() if ARRAY.search(str(hint))
    }
    return _check(function)


def _check_fields(owner: type) -> None:
    """Check what a dataclass keeps, which may be narrower than what it is given."""
    own = vars(sys.modules[owner.__module__])
    hints = {name: eval(text, own) for name, text in _arrays(owner).items()}
    init = owner.__init__
    if not hints:
        return

    @functools.wraps(init)
    def checked(self: Any, *args: Any, **given: Any) -> None:
        init(self, *args, **given)
        if not torch.compiler.is_compiling():
            with jaxtyping.jaxtyped("context"):
                for name, hint in hints.items():
                    die_if_unbearable(getattr(self, name), hint)

    owner.__init__ = checked


def _arrays(annotated: Any) -> dict[str, str]:
    return {name: text for name, text in annotated.__annotations__.items() if ARRAY.search(str(text))}
