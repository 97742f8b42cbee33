"""The directive `public-names`: a heading and the docstring of each public name of a package."""

from __future__ import annotations

import importlib
import inspect
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive, directives
from docutils.statemachine import StringList
from sphinx.ext.autodoc.mock import mock
from sphinx.pycode import ModuleAnalyzer

import sdm

MEMBERS = ("   :members:", "   :undoc-members:")


def names_of(module: Any) -> list[str]:
    """Public names: `__all__`, or what the module itself defines."""
    listed = getattr(module, "__all__", None)
    if listed is not None:
        return list(listed)
    return [name for name, value in vars(module).items() if name[0] != "_" and value_home(value) == module.__name__]


def value_home(value: Any) -> str | None:
    """The module that defines a function or a class; None of other values."""
    return value.__module__ if inspect.isfunction(value) or inspect.isclass(value) else None


def entry(package: str, name: str, value: Any) -> list[str]:
    """The lines of autodoc for one name."""
    full = f"{package}.{name}"
    if package != "sdm" and name in sdm.__all__:
        return [f":py:obj:`sdm.{name}`", "   is among the library's first names.", ""]
    if inspect.ismodule(value):
        return [f".. automodule:: {full}", "   :members:", ""]
    if inspect.isclass(value):
        members = () if issubclass(value, Exception) else MEMBERS
        bases = () if value.__bases__ == (object,) else ("   :show-inheritance:",)
        return [f".. autoclass:: {full}", *members, *bases, ""]
    if callable(value):
        return [f".. autofunction:: {full}", ""]
    return [f".. py:data:: {full}", "", f"   ``{value!r}``" if len(repr(value)) < 200 else "", ""]


def show_whole_signature(value: Any) -> None:
    """Let autodoc print a function's own signature, not its overloads, which leave most options to a type.

    The analyzer of a module is kept by Sphinx, which asks it for overloads later.
    """
    home = value_home(value)
    if home is not None and home.startswith("sdm."):
        analyzer = ModuleAnalyzer.for_module(home)
        analyzer.analyze()
        analyzer.overloads.clear()


class PublicNames(Directive):
    """`.. public-names:: sdm.shapes`, with `:only:` or `:but:` a list of names."""

    required_arguments = 1
    option_spec = {"only": directives.unchanged, "but": directives.unchanged}  # noqa: RUF012

    def run(self) -> list[nodes.Node]:
        """Nodes of all names."""
        package = self.arguments[0]
        only = self.options.get("only", "").split()
        but = self.options.get("but", "").split()
        lines: list[str] = []
        with mock(self.state.document.settings.env.config.autodoc_mock_imports):
            module = importlib.import_module(package)
            for name in only or sorted(names_of(module), key=str.lower):
                if name not in but:
                    show_whole_signature(getattr(module, name))
                    lines += entry(package, name, getattr(module, name))
        node = nodes.section()
        node.document = self.state.document
        self.state.nested_parse(StringList(lines, package), self.content_offset, node)
        return node.children


def escape_bars(_app: Any, _kind: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Absolute values are no substitutions of reStructuredText: escape bars that no backticks are around."""
    for i, line in enumerate(lines):
        parts = line.split("`")
        lines[i] = "`".join(part if odd % 2 else part.replace("|", r"\|") for odd, part in enumerate(parts))


def setup(app: Any) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("public-names", PublicNames)
    app.connect("autodoc-process-docstring", escape_bars)
    return {"parallel_read_safe": True}
