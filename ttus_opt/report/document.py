"""A report as a list of blocks, written as Markdown and as one self-contained page."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from ttus_opt.core import html_card, io
from ttus_opt.report.tables import table

_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:64em;margin:2em auto;"
    "padding:0 1em}table{border-collapse:collapse;font-size:13px;margin:1em 0}"
    "td,th{border:1px solid #ccc;padding:.25em .6em;text-align:left}"
    "th{background:#f3f3f3}img{max-width:100%}figcaption{color:#555}"
)


@dataclass(frozen=True)
class Heading:
    """A heading; level 1 is the title."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Text:
    """A paragraph; the only markup is ``**bold**`` and ``code`` in backquotes."""

    text: str


@dataclass(frozen=True)
class Items:
    """A list of lines with the markup of `Text`."""

    lines: Sequence[str]


@dataclass(frozen=True)
class Table:
    """A table of cells with the markup of `Text`."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Picture:
    """A PNG file, by its path relative to the report."""

    path: str
    caption: str


Block = Heading | Text | Items | Table | Picture


def write_markdown(path: Path, blocks: Sequence[Block]) -> None:
    """Write the blocks as Markdown, replacing ``path`` only on success."""
    io.write_text(path, "\n\n".join(map(markdown, blocks)) + "\n")


def write_html(path: Path, title: str, blocks: Sequence[Block]) -> None:
    """Write the blocks as one HTML page, replacing ``path`` only on success.

    Pictures are read from the folder of ``path`` and embedded.
    """
    body = "\n".join(_html(block, path.parent) for block in blocks)
    page = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n"
        f"<body>\n{body}\n</body></html>\n"
    )
    io.write_text(path, page)


def markdown(block: Block) -> str:
    """One block as Markdown.

    >>> markdown(Heading("Errors"))
    '## Errors'
    """
    match block:
        case Heading():
            return f"{'#' * block.level} {block.text}"
        case Text():
            return block.text
        case Items():
            return "\n".join(f"- {line}" for line in block.lines)
        case Table():
            return table(block.header, block.rows)
        case Picture():
            return f"![{block.caption}]({block.path})\n\n*{block.caption}*"


def _html(block: Block, folder: Path) -> str:
    match block:
        case Heading():
            return f"<h{block.level}>{_inline(block.text)}</h{block.level}>"
        case Text():
            return f"<p>{_inline(block.text)}</p>"
        case Items():
            lines = "".join(f"<li>{_inline(line)}</li>" for line in block.lines)
            return f"<ul>{lines}</ul>"
        case Table():
            return _styled(html_card.table(block.header, block.rows))
        case Picture():
            data = base64.b64encode((folder / block.path).read_bytes()).decode()
            return (
                f'<figure><img alt="{escape(block.caption)}" '
                f'src="data:image/png;base64,{data}">'
                f"<figcaption>{_inline(block.caption)}</figcaption></figure>"
            )


def _inline(text: str) -> str:
    """Text with its bold and code markup as HTML."""
    return _styled(escape(text))


def _styled(escaped: str) -> str:
    bold = re.sub(r"\*\*(.+?)\*\*", r"<b>\1</b>", escaped)
    return re.sub(r"`(.+?)`", r"<code>\1</code>", bold)
