"""The command line ``ttus-opt``: one command per file."""

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False  # without the cost of loading typing
if TYPE_CHECKING:
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
        # nothing large is loaded before this, so that few interrupts come earlier
        from ttus_opt.core.interrupts import ended_at_once

        with ended_at_once():
            _begin(next(iter(sys.argv[1:]), ""))
    from ttus_opt.cli.app import main as run

    run(arguments)


def _begin(command: str) -> None:
    """Go on in a child process and load the command line there."""
    from ttus_opt.cli.supervisor import run_supervised

    run_supervised(command)  # before any thread runs
    _one_blas_thread(command)
    import ttus_opt.cli.app  # noqa: F401


def _one_blas_thread(command: str) -> None:
    """Dense algebra by one thread, unless the environment says how many.

    A fit's dense matrices are small. Threads that wait for the next of them keep the
    processors busy, and numpy and scipy bring some each: choosing weights took five
    times the processor time. A benchmark lets every solver have what it finds.
    """
    variables = {"OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OMP_NUM_THREADS"}
    if command != "benchmark" and not variables & os.environ.keys():
        os.environ["OPENBLAS_NUM_THREADS"] = "1"
