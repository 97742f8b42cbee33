"""Notebooks of examples, a cell for each paragraph of the script: `make notebooks`, which needs nothing installed."""

from __future__ import annotations

import ast
import json
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"
# Those whose figures are pyplot's, which notebooks show below the cell.
NAMES = ("cnn_on_the_stream", "descend_onto_a_surface")


def notebook(name: str, script: str) -> str:
    """The notebook of a script as the text of its file: what it is, the cells, and the picture that they leave.

    Cells have no outputs, so that the same script gives the same file.
    """
    docstring = ast.get_docstring(ast.parse(script)) or ""
    head = f"# {name.replace('_', ' ').capitalize()}\n\n{docstring}\n\n(Made from [{name}.py]({name}.py).)"
    tail = f"What it leaves:\n\n![{name.replace('_', ' ')}]({name}.png)"
    cells = [_cell("markdown", head), *(_cell("code", text) for text in paragraphs(script)), _cell("markdown", tail)]
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {
        "cells": cells,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(whole, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def paragraphs(script: str) -> list[str]:
    """The code of a script in pieces that run one after the other: statements with no empty line between them."""
    lines = script.splitlines()
    statements = ast.parse(script).body[1:]  # without the docstring
    pieces: list[str] = []
    begin = statements[0].lineno - 1
    for statement, following in zip(statements, [*statements[1:], None], strict=True):
        end = statement.end_lineno or statement.lineno
        until = len(lines) if following is None else following.lineno - 1
        # A comment after the empty line goes with what follows it.
        gap = next((at for at in range(end, until) if not lines[at].strip()), None)
        imports = isinstance(statement, ast.Import | ast.ImportFrom) and isinstance(
            following, ast.Import | ast.ImportFrom
        )
        if following is None:
            pieces.append("\n".join(lines[begin:]).strip())
        elif gap is not None and not imports:
            pieces.append("\n".join(lines[begin:gap]).strip())
            begin = gap
    return pieces


def _cell(kind: str, text: str) -> dict[str, object]:
    code: dict[str, object] = {"execution_count": None, "outputs": []} if kind == "code" else {}
    return {"cell_type": kind, "metadata": {}, "source": text.splitlines(keepends=True), **code}


def main() -> None:
    """Write the notebooks beside their scripts."""
    for name in NAMES:
        script = (EXAMPLES / f"{name}.py").read_text()
        (EXAMPLES / f"{name}.ipynb").write_text(notebook(name, script))


if __name__ == "__main__":
    main()
