"""The directive `command-help`: what `sdm COMMAND --help` prints, without the frames that a terminal has around it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import textwrap
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive

WIDTH = 96


def help_of(command: str) -> str:
    """The help text of a command as plain lines."""
    words = [sys.executable, "-m", "sdm.cli", *command.split(), "--help"]
    environment = {**os.environ, "COLUMNS": str(WIDTH + 4), "NO_COLOR": "1"}
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=True)  # noqa: S603
    lines = [short for line in done.stdout.splitlines() for short in wrapped(plain(line))]
    # One empty line where argparse and our examples leave two.
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).strip("\n")


def wrapped(line: str) -> list[str]:
    """A line as lines that fit: paragraphs of the description come in one."""
    indent = " " * (len(line) - len(line.lstrip()))
    return textwrap.wrap(line, WIDTH, subsequent_indent=indent, break_on_hyphens=False) or [""]


def plain(line: str) -> str:
    """A line without its frame: headings end with a colon, bottoms of frames are empty lines."""
    if heading := re.match(r"╭─ (.*?) ─*╮$", line):
        return f"{heading[1]}:"
    if re.match(r"╰─*╯$", line):
        return ""
    if inner := re.match(r"│ ?(.*?)\s*│$", line):
        return f"  {inner[1]}".rstrip()
    return line.rstrip()


class CommandHelp(Directive):
    """`.. command-help:: train sdmnn`."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """A block with the help text."""
        text = help_of(self.arguments[0])
        return [nodes.literal_block(text, text, language="text")]


def setup(app: Any) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True}
