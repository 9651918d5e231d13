"""The process that waits for a command: it ends as the command does."""

import os
import signal
import subprocess
import time

import pytest

from tests import kit
from ttus_opt import cli
from ttus_opt.cli import supervisor
from ttus_opt.core.interrupts import INTERRUPTED

pytestmark = pytest.mark.skipif(
    not hasattr(os, "fork"), reason="the system cannot fork"
)

#: What a child that hears nothing is given to clean up here [s]
GRACE = 0.2

#: A command that does what follows, without loading the rest of the package
COMMAND = """
import importlib.util, os, signal, sys, time
spec = importlib.util.spec_from_file_location("supervisor", {file!r})
supervisor = importlib.util.module_from_spec(spec)
spec.loader.exec_module(supervisor)
supervisor.GRACE = {grace}
{before}
supervisor.run_supervised("fit")
"""


@pytest.fixture
def started(tmp_path):
    """Processes that are ended whatever happens."""
    running: list[subprocess.Popen[str]] = []
    yield running
    for process in running:
        process.kill()
        process.communicate()


def command(does, started, grace=20.0, before=""):
    """A supervised process, once it says that it is at work."""
    script = COMMAND.format(file=supervisor.__file__, grace=grace, before=before)
    process = kit.started("-c", f"{script}\nprint('at work', flush=True)\n{does}")
    started.append(process)
    assert process.stdout.readline() == "at work\n"
    return process


@pytest.mark.parametrize(
    ("does", "status"),
    [
        ("sys.exit(2)", 2),
        ("pass", 0),
        ("os.kill(os.getpid(), signal.SIGKILL)", -signal.SIGKILL),
        ("os.kill(os.getpid(), signal.SIGSEGV)", -signal.SIGSEGV),
    ],
)
def test_it_ends_as_its_child(does, status, started):
    assert command(does, started).wait(60.0) == status


@pytest.mark.parametrize(
    ("sent", "status"),
    [(signal.SIGINT, INTERRUPTED), (signal.SIGTERM, supervisor.TERMINATED)],
)
def test_a_child_that_hears_nothing_is_ended(sent, status, started):
    deaf = "signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())"
    process = command(
        f"{deaf}\nprint('deaf', flush=True)\ntime.sleep(60)", started, GRACE
    )
    assert process.stdout.readline() == "deaf\n"
    start = time.monotonic()
    process.send_signal(sent)
    assert process.wait(60.0) == status
    assert time.monotonic() - start >= GRACE
    assert ("nothing further was written" in process.stderr.read()) == (
        sent == signal.SIGINT
    )


def test_a_child_cleans_up_within_its_time(started):
    does = """
try:
    print("in the middle", flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    print('clean', flush=True)
    sys.exit(130)
"""
    process = command(does, started)
    assert process.stdout.readline() == "in the middle\n"
    # a tick of the clock that comes in the same moment must not end the child
    for number in (signal.SIGSTOP, signal.SIGALRM, signal.SIGINT, signal.SIGCONT):
        process.send_signal(number)
    assert process.wait(60.0) == INTERRUPTED
    assert process.stdout.read() == "clean\n"


def test_an_interrupt_after_the_child_has_ended_is_too_late(started):
    before = """
def reaped(*given, waitpid=os.waitpid):
    found = waitpid(*given)
    os.kill(os.getpid(), signal.SIGINT)
    return found
os.waitpid = reaped
"""
    process = command("pass", started, before=before)
    assert (process.wait(60.0), process.stderr.read()) == (0, "")


@pytest.mark.parametrize("word", ["", "--help", *supervisor.ALONE])
def test_what_is_over_at_once_has_no_child(word, monkeypatch):
    monkeypatch.setattr(os, "fork", lambda: pytest.fail("forked"))
    supervisor.run_supervised(word)


@pytest.mark.parametrize(
    ("command", "told", "threads"),
    [
        ("fit", {}, "1"),
        ("benchmark", {}, None),
        ("fit", {"OPENBLAS_NUM_THREADS": "4"}, "4"),
        ("fit", {"OMP_NUM_THREADS": "4"}, None),
    ],
)
def test_dense_algebra_has_one_thread_unless_the_environment_says_otherwise(
    command, told, threads, monkeypatch
):
    monkeypatch.setattr(os, "environ", dict(told))
    cli._one_blas_thread(command)
    assert os.environ.get("OPENBLAS_NUM_THREADS") == threads
