"""Facts by name as a small table for notebooks, in HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape


def facts_table(title: str, facts: Mapping[str, object], notes: Sequence[str] = ()) -> str:
    """HTML of a title, a row for each fact, and sentences below them. All texts are escaped."""
    rows = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(_text(value))}</td></tr>'
        for name, value in facts.items()
    )
    listed = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return f"<div><b>{escape(title)}</b><table>{rows}</table>{f'<ul>{listed}</ul>' if notes else ''}</div>"


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
