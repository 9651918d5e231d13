"""Time limits: a command ends with one line, and nothing is half-written."""

import ctypes
import signal
import subprocess
import time

import pytest
import typer

from tests.cli.conftest import empty, fit_words, refused
from tests.cli.test_interrupts import deaf_at_work
from ttus_opt.cli.app import app
from ttus_opt.cli.time_limit import interrupts_unwrapped, time_limited
from ttus_opt.core.errors import InputError, TtusError

pytestmark = pytest.mark.skipif(
    not hasattr(signal, "setitimer"), reason="the system has no alarm"
)


MANY_SOLVES = ["refine-poses", "tune", "path", "session", "experiment"]
UNLIMITED = [
    *["benchmark", "record", "view", "solvers", "formulations", "warm-up"],
    *(f"live {part}" for part in ["demo", "page", "follower", "operator", "key"]),
]


def test_every_command_states_its_limit():
    group = typer.main.get_command(app)
    for name, command in group.commands.items():
        inner = getattr(command, "commands", {})
        for part, own in inner.items() or [("", command)]:
            whole = f"{name} {part}".strip()
            limits = [o.default for o in own.params if o.name == "time_limit"]
            if whole not in UNLIMITED:
                usual = 3600.0 if whole in MANY_SOLVES else 600.0
                assert limits == [usual], whole


def test_a_command_ends_in_time(run, files, output):
    fit = fit_words(files, output / "f.nc")
    for words in (fit, fit.replace("fit ", "tune ", 1).partition(" -o")[0]):
        told = "time limit of 0.05 s is over: nothing further was written"
        refused(run(f"{words} --time-limit 0.05"), told)
    assert empty(output)
    refused(run(f"{fit} --time-limit 0"), "--time-limit must be positive")


def test_an_interrupt_in_a_callback_is_not_lost():
    """Of a compiler, for instance: there no error can be raised."""

    @ctypes.CFUNCTYPE(None)
    def struck():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), interrupts_unwrapped():
        struck()
        for _ in range(100):
            time.sleep(0.05)


@pytest.mark.parametrize("kind", [SystemError, RuntimeError])
def test_an_interrupt_that_was_wrapped_is_one(kind):
    """By compiled code that returned, or by a class that was being made."""

    def raised(cause):
        with interrupts_unwrapped():
            raise kind("returned a result with an exception set") from cause

    with pytest.raises(KeyboardInterrupt):
        raised(KeyboardInterrupt())
    with pytest.raises(kind):
        raised(None)


def test_a_partial_result_is_no_success():
    """What a command does at Ctrl-C, it does when its time is over."""
    kept = []

    def act():
        try:
            signal.raise_signal(signal.SIGALRM)  # as at the end, whenever that comes
        except KeyboardInterrupt:
            kept.append("what is complete")
            raise typer.Exit(130) from None

    with pytest.raises(TtusError, match="time limit of 100 s"), time_limited(100.0):
        act()
    assert kept
    with pytest.raises(InputError), time_limited(float("inf")):
        pass


def test_other_interrupts_and_statuses_stay():
    before = signal.getsignal(signal.SIGALRM)
    for kind in (KeyboardInterrupt, typer.Exit):
        with pytest.raises(kind), time_limited(100.0):
            raise kind
    with time_limited(None):
        pass
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert signal.getsignal(signal.SIGALRM) is before


@pytest.mark.slow
def test_a_solver_that_never_listens_is_ended(files, tmp_path):
    process = deaf_at_work("fit --time-limit 20", files, tmp_path)
    try:
        _, told = process.communicate(timeout=60.0)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    assert process.returncode == 2
    assert told.strip().splitlines()[-1].startswith("error: the time limit is over")
    assert empty(tmp_path / "output")
