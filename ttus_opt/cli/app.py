"""The commands put together, and the one place where errors become exit statuses."""

from __future__ import annotations

import contextlib
import functools
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from ttus_opt.cli import live_commands
from ttus_opt.cli.benchmark_command import benchmark
from ttus_opt.cli.command import COMMON, add_command
from ttus_opt.cli.compensate_command import compensate
from ttus_opt.cli.console import as_options, one_line, warnings_in_one_line
from ttus_opt.cli.demo_command import demo
from ttus_opt.cli.doctor_command import doctor
from ttus_opt.cli.evaluate_command import evaluate
from ttus_opt.cli.example_command import example
from ttus_opt.cli.experiment_command import experiment
from ttus_opt.cli.fit_command import fit
from ttus_opt.cli.hand_eye_command import hand_eye as hand_eye_of_streams
from ttus_opt.cli.list_commands import formulations, solvers
from ttus_opt.cli.message_commands import decode, encode
from ttus_opt.cli.next_press_command import next_press
from ttus_opt.cli.path_command import path
from ttus_opt.cli.record_command import record
from ttus_opt.cli.refine_poses_command import refine_poses
from ttus_opt.cli.register_command import board, hand_eye, markers
from ttus_opt.cli.render_command import render
from ttus_opt.cli.session_command import session
from ttus_opt.cli.surface_command import surface
from ttus_opt.cli.synchronise_command import synchronise
from ttus_opt.cli.tune_command import tune
from ttus_opt.cli.view_command import view
from ttus_opt.cli.warm_up_command import warm_up
from ttus_opt.core.errors import MistakeWarning, NumericalError, TtusError
from ttus_opt.core.interrupts import INTERRUPTED, STOPPED
from ttus_opt.core.optional import extra_with

UNSOLVED, BAD_INPUT, TERMINATED = 1, 2, 143

app = typer.Typer(
    name="ttus-opt",
    help="Patient models for haptic tele-ultrasound: scan, fit, evaluate, render.",
    epilog="Example: ttus-opt demo",
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
#: Default time limits: of commands that solve many times, and of others [s]
LONG, USUAL = 3600.0, 600.0

#: All commands in the order in which help lists them, with what `add_command` is told
#: of each. Those without a time limit are over in a moment, last as long as is asked
#: for, or limit every solve.
COMMANDS: dict[Callable[..., None], dict[str, Any]] = {
    demo: {"folder": True},
    example: {},
    doctor: {},
    record: {"time_limit": None, "written": ("poses", "wrenches")},
    hand_eye_of_streams: {},
    synchronise: {},
    compensate: {"written": ("model",)},
    surface: {},
    refine_poses: {"judges": True, "time_limit": LONG},
    fit: {"judges": True},
    tune: {"judges": True, "time_limit": LONG},
    path: {"judges": True, "time_limit": LONG},
    next_press: {"judges": True},
    evaluate: {"judges": True},
    session: {"judges": True, "time_limit": LONG, "folder": True},
    experiment: {"time_limit": LONG, "folder": True},
    render: {"judges": True, "written": ("flat",)},
    view: {"judges": True, "time_limit": None},
    encode: {},
    decode: {},
    benchmark: {"time_limit": None, "folder": True},
    solvers: {"time_limit": None},
    formulations: {"time_limit": None},
    warm_up: {"time_limit": None},
}
REGISTER: dict[Callable[..., None], dict[str, Any]]
REGISTER = {board: {}, markers: {}, hand_eye: {}}
LIVE: dict[Callable[..., None], dict[str, Any]] = {
    live_commands.demo: {"time_limit": None, "folder": True},
    live_commands.page: {"time_limit": None},
    live_commands.report: {"written": ("recording",)},
    live_commands.replay: {},
    live_commands.key: {"time_limit": None},
    live_commands.follower: {"time_limit": None},
    live_commands.operator: {"time_limit": None},
}
cameras = typer.Typer(
    help="Find markers in a photo, or a camera's place from pairs of poses.",
    epilog="Example: ttus-opt register hand-eye pairs.json --camera fixed "
    "-o camera_to_base.json",
    rich_markup_mode=None,
)
live = typer.Typer(
    help="Live sessions over a delayed, lossy link. Not a medical device.",
    epilog="Example: ttus-opt live demo",
    rich_markup_mode=None,
)
for group, members in ((app, COMMANDS), (cameras, REGISTER), (live, LIVE)):
    for function, how in members.items():
        add_command(group, function, **{"time_limit": USUAL, **how})
app.add_typer(cameras, name="register")
app.add_typer(live, name="live")


def _version(asked: bool) -> None:
    if asked:
        import importlib.metadata

        typer.echo(f"ttus-opt {importlib.metadata.version('ttus-opt')}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_version, is_eager=True
        ),
    ] = False,
    verbose: Annotated[
        int,
        typer.Option(
            "-v", "--verbose", count=True, show_default=False, help=COMMON["verbose"]
        ),
    ] = 0,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help=COMMON["quiet"])] = False,
) -> None:
    """Patient models for haptic tele-ultrasound: scan, fit, evaluate, render."""


@functools.cache
def program() -> Any:
    """All commands in click's form, made once for a process."""
    return typer.main.get_command(app)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; the entry point ``ttus-opt``.

    Args:
        arguments: Words after the program's name; the process's own when not given.

    Raises:
        SystemExit: Always: 0, or one line on stderr and 1 where an iteration did not
            converge, 2 for bad input, 130 when interrupted.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        with warnings_in_one_line(), _termination_as_exit():
            status = program()(
                args=words or ["--help"],
                prog_name="ttus-opt",
                standalone_mode=False,
            )
    except (KeyboardInterrupt, typer.Abort):
        status = INTERRUPTED
    except typer.Exit as stop:
        status = stop.exit_code
    except MemoryError as error:
        what = str(error) or f"in {_place(error)}"
        _end(f"out of memory: {what}: choose a smaller shape", BAD_INPUT)
    except MistakeWarning as likely:
        _end(as_options(str(likely)), BAD_INPUT)
    except NumericalError as error:
        _end(as_options(str(error)), UNSOLVED)
    except (TtusError, OSError) as error:
        _end(as_options(str(error)), BAD_INPUT)
    except Exception as error:
        if (told := _told(error)) is None:
            raise
        _end(told, BAD_INPUT)
    if status == INTERRUPTED:  # typer may have turned the interrupt into a status
        # Python remembers one that struck within an exec, as of a dataclass that was
        # being made, until the next, and would end by the signal instead
        exec("")
        _end(STOPPED.removeprefix("error: "), INTERRUPTED)
    sys.exit(status if isinstance(status, int) else 0)


@contextlib.contextmanager
def _termination_as_exit() -> Iterator[None]:
    """SIGTERM as an exception, so that temporary files are removed."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _told(error: Exception) -> str | None:
    """A package of an extra that is absent, or what the parser says of options."""
    if isinstance(error, ModuleNotFoundError) and error.name:
        extra = extra_with(error.name)
        install = f'{error.name} is not installed: pip install "ttus-opt[{extra}]"'
        return None if extra is None else install
    described = getattr(error, "format_message", None)
    return None if described is None else described() or "see ttus-opt --help"


def _place(error: BaseException) -> str:
    """The innermost function of an error that has no message."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "ttus_opt" in frame.filename] or list(frames)
    return f"{own[-1].name} ({Path(own[-1].filename).stem})"


def _end(message: str, status: int) -> NoReturn:
    typer.echo(f"error: {one_line(message)}", err=True)
    sys.exit(status)
