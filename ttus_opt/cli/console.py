"""What commands say: JSON, tables, one-line warnings and errors, a bar, a log."""

from __future__ import annotations

import contextlib
import json
import logging
import re
import shlex
import shutil
import sys
import textwrap
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TextIO

import typer

from ttus_opt.core.errors import TtusWarning
from ttus_opt.core.saved_results import plain

if TYPE_CHECKING:
    from ttus_opt.report.document import Block

LOG = logging.getLogger(__name__)

#: The logger of the whole package
PACKAGE = logging.getLogger("ttus_opt")

#: Options that the library's keywords name otherwise
RENAMED = {
    "--probe-surface": "surface",
    "--probe-unit": "unit",
    "--torso-unit": "unit",
    "--points": "n_points",
    "--stream": "name",
    "--largest-offset": "largest",
}

#: A stage bar is shown on a terminal when the work has taken this long [s].
PATIENCE = 1.0


def one_line(text: str) -> str:
    r"""The text with line breaks and runs of spaces as one space, all of it printable.

    A terminal would carry out control characters of a file or an argument.

    >>> one_line("got \x1b[2J,  twice")
    'got �[2J, twice'
    """
    words = " ".join(text.split())
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in words)


def as_options(message: str, **options: str) -> str:
    """A message of the library in the words of the command line.

    Keywords are told as options where the command that runs has such options.

    Args:
        message: Of the library.
        options: Further options, by the keywords of the library.

    >>> as_options("are these millimetres? pass unit='mm'", unit="--unit")
    'are these millimetres? pass --unit mm'
    >>> as_options("r_inner is 3 m: give box=…", box="--box", r_inner="--r-inner")
    '--r-inner is 3 m: give --box …'
    >>> as_options("map them by columns, for instance px=x", columns="--columns")
    'map them by --columns px=x'
    """
    own = _words.options
    renamed = {RENAMED[v]: v for v in own.values() if v in RENAMED}
    table = {**own, **renamed, **options}

    def written(match: re.Match[str]) -> str:
        option, value = table[match["name"]], match["bare"]
        if match["quoted"]:
            value = shlex.quote(match["quoted"])
        return option if value == "True" else f"{option} {value}"

    value = r"(?:(?P<q>['\"])(?P<quoted>[^'\"]+)(?P=q)|(?P<bare>[\w.,…-]*[\w…]))"
    # a term may be called force and have any other value
    told = message.replace("force=True", "--force")
    if "repair" not in table:  # nothing is mended by this command
        told = told.replace(", or read it with repair=True", "")
    for name, option in table.items():
        told = re.sub(rf"(?<![\w-])(?P<name>{name})={value}", written, told)
        if "_" in name:  # a word of Python, whatever follows
            told = re.sub(rf"(?<![\w./='\"-]){name}(?![\w./='\"])", option, told)
    told_by = f"by {table.get('columns', 'columns, for instance')} "
    return told.replace("by columns, for instance ", told_by)


def know_options(options: Mapping[str, str]) -> None:
    """The options of the command that runs, by the names of its parameters."""
    _words.options = {k: v for k, v in options.items() if k != "force"}


def print_json(content: Mapping[str, Any]) -> None:
    """Write a mapping as JSON on stdout; NaN and infinity become null."""
    typer.echo(json.dumps(plain(content), indent=2, ensure_ascii=False))


@dataclass
class _Words:
    """Where words go: to stderr where a result takes stdout; a folder is not named.

    Bars are those that have begun and not ended; options are the command's, by name.
    """

    json: bool = False
    to_stderr: bool = False
    unnamed: str = ""
    bars: list[Stages] = field(default_factory=list)
    options: Mapping[str, str] = field(default_factory=dict)


_words = _Words()


def tell(facts: Mapping[str, Any], *lines: str) -> None:
    """Say what was done: facts for machines with --json, lines for people."""
    if _words.json:
        print_json(facts)
    elif lines:
        text = "\n".join(map(_narrow, lines))
        if _words.unnamed:
            text = text.replace(_words.unnamed, "")
        typer.echo(text, err=_words.to_stderr)


def _narrow(line: str) -> str:
    """A line as a terminal shows it whole; what others read is not broken."""
    shown = (sys.stderr if _words.to_stderr else sys.stdout).isatty()
    return wrapped(line) if shown and "\n" not in line else line


@contextlib.contextmanager
def words_beside(taken: bool, place: str) -> Iterator[None]:
    """What was done is said on stderr where stdout is taken by a command's result.

    Args:
        taken: Whether it is.
        place: Folder of the files that stand for streams, left out of what is said.
    """
    _words.to_stderr, _words.unnamed = taken, place
    try:
        yield
    finally:
        _words.to_stderr, _words.unnamed = False, ""


def fitted(*blocks: Block) -> str:
    """Tables and other blocks of a report, no wider than the terminal."""
    from ttus_opt.report.document import text

    return text(blocks, shutil.get_terminal_size().columns)


def wrapped(text: str) -> str:
    """A paragraph that is no wider than the terminal."""
    width = shutil.get_terminal_size().columns
    return textwrap.fill(text, width, break_long_words=False, break_on_hyphens=False)


@contextlib.contextmanager
def speaking(verbose: int, *, quiet: bool, json: bool) -> Iterator[None]:
    """Show what the package logs, above a bar, with the seconds since the beginning.

    Args:
        verbose: 0 for nothing, 1 for what is read, chosen and solved, 2 for more.
        quiet: Show no bars (`bars_shown`).
        json: `tell` facts to a machine.
    """
    begun, before = time.monotonic(), PACKAGE.level
    handler = logging.Handler()

    def show(record: logging.LogRecord) -> None:
        room = record.name.removeprefix("ttus_opt.")
        text = one_line(record.getMessage())
        _write(f"{time.monotonic() - begun:7.2f} s  {room}: {text}")

    handler.emit = show  # type: ignore[method-assign]
    levels = (logging.WARNING, logging.INFO, logging.DEBUG)
    PACKAGE.setLevel(logging.ERROR if quiet else levels[min(verbose, 2)])
    PACKAGE.addHandler(handler)
    _words.json = json
    try:
        yield
    finally:
        for bar in [*_words.bars]:  # an interrupt may strike as one begins or ends
            bar.end()
        _words.json = False
        PACKAGE.removeHandler(handler)
        PACKAGE.setLevel(before)


def to_machine() -> bool:
    """Whether JSON is wanted."""
    return _words.json


def bars_shown() -> bool:
    """Whether bars are wanted; a command's --quiet says that they are not."""
    return PACKAGE.isEnabledFor(logging.WARNING)


@contextlib.contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """Print warnings as ``warning: …`` on stderr, each once; numpy's are logged."""
    shown: set[str] = set()

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if issubclass(category, RuntimeWarning):  # of numpy's arithmetic
            LOG.info("%s:%d: %s", filename, lineno, message)
            return
        text = as_options(one_line(str(message)))
        if text not in shown:
            shown.add(text)
            _write(f"warning: {text}")

    with warnings.catch_warnings():
        warnings.simplefilter("always", TtusWarning)
        warnings.showwarning = show
        yield


def _write(line: str) -> None:
    """A line on stderr, above a bar that is being shown."""
    if "tqdm" not in sys.modules:
        typer.echo(line, err=True)
        return
    from tqdm import tqdm

    tqdm.write(line, file=sys.stderr)


class Stages:
    """A bar over the stages of a command, on stderr, for work over a second.

    Call it with what begins now. A thread keeps the clock running while a stage
    computes.

    Args:
        total: Number of stages.
    """

    def __init__(self, total: int) -> None:
        self._total, self._begun, self._stage = total, 0, ""
        self._start = time.monotonic()
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._show, daemon=True)

    def __enter__(self) -> Stages:
        """Start the clock."""
        if bars_shown():
            _words.bars.append(self)
            self._thread.start()
        return self

    def __call__(self, stage: str) -> None:
        """A stage begins; the one before is done."""
        self._begun += 1
        self._stage = stage
        LOG.info("%d of %d: %s", self._begun, self._total, stage)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close the bar, full when all went well."""
        if kind is None:
            self._begun = self._total + 1
        self.end()

    def end(self) -> None:
        """Show it no more."""
        self._finished.set()
        if self._thread.ident is not None:
            self._thread.join()
        if self in _words.bars:
            _words.bars.remove(self)

    def _show(self) -> None:
        # a file or a pipe gets lines for long work only, and every few seconds
        watched = sys.stderr.isatty()
        patience = PATIENCE if watched else 5.0 * PATIENCE
        if self._finished.wait(patience):
            return
        from tqdm import tqdm

        pause = 0.2 if watched else 3.0
        with tqdm(
            total=self._total,
            file=sys.stderr,
            bar_format="{desc:<34} |{bar:24}| {n_fmt}/{total_fmt}  {elapsed}",
        ) as bar:
            bar.start_t -= patience
            while True:
                bar.n = max(self._begun - 1, 0)
                bar.set_description_str(self._stage, refresh=True)
                if self._finished.wait(pause):
                    break
            bar.n = max(self._begun - 1, 0)
            done = bar.n == self._total
            bar.set_description_str("done" if done else self._stage, refresh=True)
