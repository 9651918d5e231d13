"""The command line ``ttus-opt``: one command per file."""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; the entry point ``ttus-opt``.

    Args:
        arguments: Words after the program's name, for a call within Python; the
            process's own when not given, and a command that computes then runs in a
            process that can be stopped (`ttus_opt.cli.supervisor`).

    Raises:
        SystemExit: Always: 0, or 2 after one line on stderr, or 130 when interrupted.
    """
    if arguments is None:
        from ttus_opt.cli.supervisor import run_supervised

        # before anything large is loaded, or any thread runs
        run_supervised(next(iter(sys.argv[1:]), ""))
    from ttus_opt.cli.app import main as run

    run(arguments)
