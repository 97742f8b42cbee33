"""Blocks of a Markdown page: Python and command lines, in their order, with the marks of those that are not run."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

FENCE = re.compile(r"^(?:<!-- (.*?) -->\n)?```(\w+)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# A comment right above a block: why it is compiled, or its commands are parsed, and no more.
MARKS = ("not run here: ", "compiled only: ")


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Args:
        language: As its fence says: python, py or sh.
        text: Its lines.
        reason: Why it is not run; None if it is.
    """

    language: str
    text: str
    reason: str | None

    def commands(self) -> list[str]:
        """Command lines of a block of the shell, without comments."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [line.split(" #")[0].strip() for line in lines if line.strip() and not line.startswith("#")]


def blocks(page: Path) -> list[Block]:
    """Blocks of Python and of the shell. `py` is Python that is compiled alone."""
    found = []
    for comment, language, text in FENCE.findall(page.read_text()):
        if language not in ("python", "py", "sh"):
            continue
        mark = next((mark for mark in MARKS if comment.startswith(mark)), None)
        reason = comment.removeprefix(mark) if mark else None
        found.append(Block(language, text, reason or ("py" if language == "py" else None)))
    return found


def put_demo_mesh(folder: Path) -> None:
    """Make a folder what `sdm demo` leaves, with a small mesh: `demo/demo.ply`."""
    import trimesh

    from sdm.core.demo_mesh import demo_mesh

    (folder / "demo").mkdir()
    vertices, faces = demo_mesh(rings=41, segments=16, cap_rings=3).numpy()
    trimesh.Trimesh(vertices, faces, process=False).export(folder / "demo" / "demo.ply")
