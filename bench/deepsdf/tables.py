"""Tables of DeepSDF's figures, in Markdown."""

from __future__ import annotations

from typing import Any


def rows_table(rows: list[dict[str, Any]], columns: dict[str, str]) -> list[str]:
    """Lines of a table: `columns` says which values, and what they are called."""
    head = "| " + " | ".join(columns.values()) + " |"
    body = ["| " + " | ".join(text(row.get(key, "")) for key in columns) + " |" for row in rows]
    return [head, "|" + "---|" * len(columns), *body]


def pairs(values: dict[str, Any]) -> list[str]:
    """Lines of a table of names and values."""
    return ["| | |", "|---|---|", *(f"| {key} | {text(value)} |" for key, value in values.items())]


def text(value: Any) -> str:
    """Four digits of a fraction; the rest as it is."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
