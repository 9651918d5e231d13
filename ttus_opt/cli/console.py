"""What the commands say: JSON, one-line warnings and errors, a stage bar on stderr."""

from __future__ import annotations

import contextlib
import json
import re
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any, TextIO

import typer

from ttus_opt.core.errors import TtusWarning
from ttus_opt.core.json_values import plain

#: How keywords of the library are written as options.
OPTIONS = {
    "unit": "--unit",
    "drop_nan": "--drop-nan",
    "inner": "--inner",
    "solver": "--solver",
    "surface": "--probe-surface",
    "box": "--box",
    "head": "--head",
    "prone": "--prone",
    "camera": "--camera",
    "repair": "--repair",
    "weights": "--weights",
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

    >>> as_options("are these millimetres? pass unit='mm'")
    'are these millimetres? pass --unit mm'
    """
    table = {**OPTIONS, **options}

    def written(match: re.Match[str]) -> str:
        name, value = match["name"], match["value"]
        return table[name] if value == "True" else f"{table[name]} {value}"

    pattern = rf"\b(?P<name>{'|'.join(table)})=(?P<q>['\"]?)(?P<value>[\w-]+)(?P=q)"
    return re.sub(pattern, written, message)


def print_json(content: Mapping[str, Any]) -> None:
    """Write a mapping as JSON on stdout; NaN and infinity become null."""
    typer.echo(json.dumps(plain(content), indent=2, ensure_ascii=False))


def tell(facts: Mapping[str, Any], *lines: str, json: bool) -> None:
    """Say what was done: facts for machines, lines for people."""
    if json:
        print_json(facts)
    elif lines:
        typer.echo("\n".join(lines))


@contextlib.contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """Print this package's warnings as ``warning: …`` on stderr, each once."""
    shown: set[str] = set()

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
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
        self._thread.start()
        return self

    def __call__(self, stage: str) -> None:
        """A stage begins; the one before is done."""
        self._begun += 1
        self._stage = stage

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the bar, full when all went well."""
        if kind is None:
            self._begun = self._total + 1
        self._finished.set()
        self._thread.join()

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
