"""Ctrl-C: every command ends within two seconds, whatever solver is at work."""

import os
import signal
import time
from pathlib import Path

import pytest

from tests.cli.conftest import PROBE, empty
from tests.kit import python, started
from ttus_opt import example
from ttus_opt.core.interrupts import STOPPED
from ttus_opt.solvers import registry
from ttus_opt.voxmap.field import PotentialField

#: A solver that neither heeds an interrupt nor ends: it holds Python's lock in C
DEAF = """
import ctypes, signal
from ttus_opt.solvers.base import Capabilities, Solver

class Deaf(Solver):
    name, summary = "deaf", "never ends"
    capabilities = Capabilities(inequalities=True, equalities=True)

    def prepare(self, program, request):
        open("at_work", "w").close()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as libraries have been seen to
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        ctypes.PyDLL(None).sleep(100)

SOLVERS = [Deaf()]
"""


def interrupted(process, *, terminal):
    """Interrupt as `kill -INT` or a terminal does, and wait until it has ended."""
    (os.killpg if terminal else os.kill)(process.pid, signal.SIGINT)
    process.wait(60.0)


def deaf_at_work(command, files, folder):
    """A command whose solver never listens, once that solver is at work.

    Args:
        command: Its first word, and options of its own.
        files: Surface and recording.
        folder: Where it runs; it writes into ``output`` there.
    """
    (folder / "deaf.py").write_text(DEAF)
    (folder / "output").mkdir()
    words = (
        f"{command} --surface {files / 'surface.nc'} --probe {PROBE} --points 60 "
        f"--trajectory {files / 'press.csv'} --shape 6,12,6 --solver deaf.py "
        f"-o {folder / 'output' / 'f.nc'}"
    ).split()
    process = started("-m", "ttus_opt", *words, cwd=folder)
    while not (folder / "at_work").exists():
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    return process


@pytest.mark.slow
@pytest.mark.parametrize(
    "terminal",
    [True, pytest.param(False, marks=pytest.mark.slow)],
    ids=["terminal", "kill"],
)
def test_a_solver_that_never_listens(files, tmp_path, terminal):
    process = deaf_at_work("fit", files, tmp_path)
    interrupted(process, terminal=terminal)
    assert process.returncode == 130
    assert process.communicate()[1].strip().endswith("nothing further was written")
    assert empty(tmp_path / "output")
    with pytest.raises(ProcessLookupError):  # nothing of it goes on
        os.killpg(process.pid, 0)


@pytest.mark.slow
def test_a_second_interrupt_ends_a_path_at_once(files, tmp_path):
    """The first leaves it time to write the points it has."""
    process = deaf_at_work("path --weight force=1e-2,1", files, tmp_path)
    process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert process.poll() is None
    interrupted(process, terminal=False)
    assert process.returncode == 130
    assert process.communicate()[1].strip().endswith("nothing further was written")
    assert empty(tmp_path / "output")


def children(number):
    """Process numbers of a process's children."""
    listed = Path(f"/proc/{number}/task/{number}/children")
    return listed.read_text().split() if listed.exists() else []


@pytest.mark.slow
@pytest.mark.skipif(not children(os.getppid()), reason="needs Linux's list of children")
@pytest.mark.parametrize("library", ["libc", "numpy"])
def test_workers_show_no_traceback(library, tmp_path):
    """A terminal interrupts workers too; the demo ends them."""
    process = started("-m", "ttus_opt", "live", "demo", "-o", "out", cwd=tmp_path)
    loading = False  # a worker that has this library, and not yet all
    while not loading:
        assert process.poll() is None, process.communicate()
        workers = [w for own in children(process.pid) for w in children(own)]
        maps = [Path(f"/proc/{worker}/maps").read_text() for worker in workers]
        loading = any(library in loaded for loaded in maps)
    interrupted(process, terminal=True)
    _, told = process.communicate()
    assert process.returncode == 130 and "Traceback" not in told, told
    assert told.strip().endswith(STOPPED), told  # no leaks either
    assert empty(tmp_path / "out")


#: Those that once did not listen
DEAF_ONCE = ("cvxpy_clarabel", "osqp", "scs")


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver",
    [
        pytest.param(s.name, marks=[] if s.name in DEAF_ONCE else pytest.mark.long)
        for s in registry.solvers().values()
        if s.installed
    ],
)
def test_every_solver_on_a_large_grid(solver, tmp_path):
    """Interrupted in assembly, set-up or iterations, as it happens to be."""
    limited = registry.solvers()[solver].capabilities.inequalities
    own = {"augmented_lagrangian": "robust", "covariance": "depth_map"}
    formulation = own.get(solver, "eq10_sign" if limited else "eq10")
    words = (
        f"fit --surface {example.path('surface.nc')} --probe {example.PROBE} "
        f"--trajectory {example.path('press_fit.csv')} --shape 48,120,60 "
        f"--formulation {formulation} --solver {solver} -o {tmp_path / 'f.nc'}"
    ).split()
    process = started("-m", "ttus_opt", *words, cwd=tmp_path)
    time.sleep(10.0)
    if process.poll() is not None:  # it was quicker: solved, or told why not
        _, told = process.communicate()
        assert process.returncode == 0 or (
            process.returncode == 2
            and told.strip().splitlines()[-1].startswith("error:")
        ), told
        return
    interrupted(process, terminal=False)
    assert process.returncode == 130
    process.communicate()
    if (tmp_path / "f.nc").exists():  # solved before, interrupted in its last stage
        PotentialField.load(tmp_path / "f.nc")
        (tmp_path / "f.nc").unlink()
    assert empty(tmp_path)


#: An interrupt within an exec, as where a dataclass is being made
WITHIN = """
import ttus_opt.cli.app as app
app.program = lambda: lambda **_: exec("raise KeyboardInterrupt")
app.main(["solvers"])
"""

#: One that a package takes for its own while it loads
TAKEN = """
import contextlib, signal
from ttus_opt.cli import app, warm_up_command
def load(_):
    with contextlib.suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
warm_up_command.compile_all = load
app.main(["warm-up", "-q"])
"""


@pytest.mark.parametrize("program", [WITHIN, TAKEN])
def test_one_that_python_or_a_package_would_lose_ends_as_any_other(program, tmp_path):
    """After the former Python would end by the signal, though it was caught."""
    (tmp_path / "within.py").write_text(program)
    told = python("-m", "within", status=130, cwd=tmp_path).stderr
    assert told.strip() == "error: interrupted: nothing further was written"
