"""A report as a list of blocks: on a terminal, as Markdown, as one page of HTML."""

from __future__ import annotations

import base64
import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import zip_longest
from pathlib import Path
from textwrap import fill, wrap
from typing import TYPE_CHECKING

from ttus_opt.core import io

if TYPE_CHECKING:
    from markdown_it import MarkdownIt
    from matplotlib.figure import Figure

#: Colours of a picture's palette: visually lossless, and small enough to embed
COLOURS = 96

_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:64em;margin:2em auto;"
    "padding:0 1em;overflow-wrap:break-word}"
    "table{border-collapse:collapse;font-size:13px;margin:1em 0;display:block;"
    "overflow-x:auto}"
    "td,th{border:1px solid #ccc;padding:.25em .6em;text-align:left}"
    "th{background:#f3f3f3}img{max-width:100%}figcaption{color:#555}"
)


#: Longest cell that is never broken [characters]
UNBROKEN = 12


class Block:
    """A part of a report; as text it is Markdown, which a terminal shows as well."""

    def fitted(self, width: int) -> str:
        """As text in so many columns, where words allow."""
        return str(self)

    def html(self, folder: Path) -> str:
        """As HTML; pictures are read from ``folder`` and embedded."""
        raise NotImplementedError


@dataclass(frozen=True)
class Heading(Block):
    """A heading; level 1 is the title.

    >>> print(Heading("Errors"))
    ## Errors
    """

    text: str
    level: int = 2

    def __str__(self) -> str:
        return f"{'#' * self.level} {self.text}"

    def html(self, folder: Path) -> str:
        """As HTML."""
        return f"<h{self.level}>{_inline(self.text)}</h{self.level}>"


@dataclass(frozen=True)
class Text(Block):
    """A paragraph; its markup is ``**bold**``, ``*italic*``, links and ``code``."""

    text: str

    def __str__(self) -> str:
        return self.text

    def fitted(self, width: int) -> str:
        """As text in so many columns."""
        return fill(self.text, width)

    def html(self, folder: Path) -> str:
        """As HTML."""
        return f"<p>{_inline(self.text)}</p>"


@dataclass(frozen=True)
class Items(Block):
    """A list of lines with the markup of `Text`."""

    lines: Sequence[str]

    def __str__(self) -> str:
        return "\n".join(f"- {line}" for line in self.lines)

    def fitted(self, width: int) -> str:
        """As text in so many columns."""
        lines = (
            fill(f"- {line}", width, subsequent_indent="  ") for line in self.lines
        )
        return "\n".join(lines)

    def html(self, folder: Path) -> str:
        """As HTML."""
        lines = "".join(f"<li>{_inline(line)}</li>" for line in self.lines)
        return f"<ul>{lines}</ul>"


@dataclass(frozen=True)
class Table(Block):
    """A table of cells with the markup of `Text`; false without rows.

    >>> print(Table(["a", "number"], [["x", "1"]]))
    | a | number |
    |---|--------|
    | x | 1      |
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    def __bool__(self) -> bool:
        return bool(self.rows)

    def __str__(self) -> str:
        lines = [
            [cell.replace("|", r"\|").replace("\n", " ") for cell in line]
            for line in (self.header, *self.rows)
        ]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.header))]
        text = [
            f"| {' | '.join(c.ljust(w) for c, w in zip(line, widths, strict=True))} |"
            for line in lines
        ]
        text.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
        return "\n".join(text)

    def fitted(self, width: int) -> str:
        r"""As text so wide, where words allow: cells are broken at blanks.

        Columns for which there is no room follow below, after the first column again.

        >>> print(Table(["", "force [N]"], [["near the fitted skin", "1"]]).fitted(21))
                        force
                        [N]
        near the        1
        fitted skin
        """
        whole = str(self)
        if len(whole.partition("\n")[0]) <= width:
            return whole
        n_blanks = len(self.header) - 1
        for parts_of in (
            _breakable,
            str.split,
        ):  # short cells, where nothing else helps
            pieces = [[_longest(c.split()) for c in self.header]]
            pieces += [[_longest(parts_of(c)) for c in row] for row in self.rows]
            least = [max(column) for column in zip(*pieces, strict=True)]
            if sum(least) + n_blanks <= width:
                break
        else:
            if len(least) > 2:
                return self._folded(least, width)
        gap = 2 if sum(least) + 2 * n_blanks <= width else 1
        widths = least.copy()  # a header is broken to the width of what it stands over
        for row in self.rows:
            widths = [max(w, len(c)) for w, c in zip(widths, row, strict=True)]
        while sum(widths) + gap * n_blanks > width and widths != least:
            wide = [w if w > m else 0 for w, m in zip(widths, least, strict=True)]
            widths[wide.index(max(wide))] -= 1
        lines = []
        for row in (self.header, *self.rows):
            parts = [wrap(c, w) for c, w in zip(row, widths, strict=True)]
            for line in zip_longest(*parts, fillvalue=""):
                cells = (c.ljust(w) for c, w in zip(line, widths, strict=True))
                lines.append((gap * " ").join(cells).rstrip())
        return "\n".join(lines)

    def _folded(self, least: Sequence[int], width: int) -> str:
        """Several tables below each other, each as wide as allowed.

        Args:
            least: Least widths of the columns.
            width: Of the text.
        """
        groups: list[list[int]] = []
        room = 0
        for k, own in enumerate(least[1:], start=1):
            if not groups or room < own + 1:  # with a blank
                groups.append([0])
                room = width - least[0]
            groups[-1].append(k)
            room -= own + 1
        return "\n\n".join(self._only(group).fitted(width) for group in groups)

    def _only(self, columns: Sequence[int]) -> Table:
        rows = [[row[k] for k in columns] for row in self.rows]
        return Table([self.header[k] for k in columns], rows)

    def without(self, column: str) -> Table:
        """All columns but one."""
        return self._only([k for k, h in enumerate(self.header) if h != column])

    def html(self, folder: Path) -> str:
        """As HTML."""
        lines = (
            "".join(f"<{tag}>{_inline(cell)}</{tag}>" for cell in line)
            for tag, line in (("th", self.header), *(("td", row) for row in self.rows))
        )
        return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def _breakable(cell: str) -> list[str]:
    """Parts of a cell that stay on one line."""
    return [cell] if len(cell) <= UNBROKEN else cell.split()


def _longest(words: Sequence[str]) -> int:
    return max(map(len, words), default=0)


@dataclass(frozen=True)
class Picture(Block):
    """A picture with a caption.

    Attributes:
        path: Its PNG file, relative to the report.
        caption: What it shows.
        figure: Written to the file by `write_report`; None where it is there.
    """

    path: str
    caption: str
    figure: Figure | None = field(default=None, repr=False, compare=False)

    def __str__(self) -> str:
        return f"![{self.caption}]({self.path})\n\n*{self.caption}*"

    def html(self, folder: Path) -> str:
        """As HTML."""
        data = base64.b64encode((folder / self.path).read_bytes()).decode()
        return (
            f'<figure><img alt="{escape(self.caption)}" '
            f'src="data:image/png;base64,{data}">'
            f"<figcaption>{_inline(self.caption)}</figcaption></figure>"
        )

    def save(self, folder: Path) -> None:
        """Write the figure with a palette, a third of the size.

        Raises:
            FileError: The folder cannot be written to.
        """
        if self.figure is None:
            return
        from PIL import Image  # comes with Matplotlib

        from ttus_opt.report.plots.canvas import save_picture

        path = folder / self.path
        save_picture(self.figure, path)
        with Image.open(path) as picture:
            small = picture.convert("RGB").quantize(COLOURS)
        with io.replacing(path) as temporary:
            small.save(temporary, format="PNG", optimize=True)


def text(blocks: Iterable[Block], width: int | None = None) -> str:
    """The blocks as Markdown, or as text in so many columns."""
    return "\n\n".join(str(b) if width is None else b.fitted(width) for b in blocks)


def write_report(folder: Path, blocks: Sequence[Block]) -> Path:
    """Write pictures, ``report.md`` and ``report.html``, which needs no other file.

    Args:
        folder: Where they are written, and where other pictures are.
        blocks: The report; its first block is its title.

    Returns:
        Path of the Markdown.

    Raises:
        FileError: The folder cannot be written to.
    """
    for block in blocks:
        if isinstance(block, Picture):
            block.save(folder)
    title = str(blocks[0]).lstrip("# ")
    body = "\n".join(block.html(folder) for block in blocks)
    page = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n"
        f"<body>\n{body}\n</body></html>\n"
    )
    io.write_text(folder / "report.html", page)
    io.write_text(folder / "report.md", text(blocks) + "\n")
    return folder / "report.md"


def _inline(words: str) -> str:
    """Text with its markup as HTML; of a file's name nothing else has a meaning."""
    rendered: str = _markdown().renderInline(words)
    return rendered


@functools.cache
def _markdown() -> MarkdownIt:
    from markdown_it import MarkdownIt

    return MarkdownIt("commonmark", {"html": False}).disable("image")
