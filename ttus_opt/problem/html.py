"""Small HTML for notebooks: a title, a few lines, a table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def page(title: str, lines: Iterable[str], *parts: str) -> str:
    """A title and lines of text above other parts."""
    text = "<br>".join(escape(line) for line in lines)
    return f"<div><b>{escape(title)}</b><br>{text}{''.join(parts)}</div>"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; all entries are text."""
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(entry)}</td>" for entry in row) + "</tr>"
        for row in rows
    )
    return f"<table><tr>{top}</tr>{body}</table>"
