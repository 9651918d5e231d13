"""The solvers there are, found by looking into this folder, and which one to take.

A backend is added by adding a file with a list ``SOLVERS``; another package offers its
own by an entry point of the group ``ttus_opt.solvers``, a user by path or as an object.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import importlib.metadata
import importlib.util
import pkgutil
from pathlib import Path
from typing import Any

import ttus_opt.solvers
from ttus_opt.errors import InputError
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Solver
from ttus_opt.user_code import told_by_line

#: Where another package offers solvers
ENTRY_POINTS = "ttus_opt.solvers"

#: What ``solver="auto"`` tries, in this order, and why. The first that is installed
#: and takes the program is chosen.
PREFERENCE: tuple[tuple[str, str], ...] = (
    ("structured", "never forms Q: exact to rounding and the fastest at every size, "
     "while the measured rows are fewer than half the voxels"),
    ("augmented_lagrangian", "penalties that are no squares as they are: Newton steps "
     "through the same dual, or over the field"),
    ("normal_equations", "any sum of squares beside a Laplace term, by multigrid under "
     "conjugate gradients: as fast, with terms over all voxels"),
    ("clarabel", "interior point on the sparse least-squares form: sure and accurate"),
    ("scs", "splitting, one factor for all iterations: two to three times faster than "
     "interior point where that factor is large, and a re-solve costs a tenth"),
    ("piqp", "interior point with a slower factor: for small problems"),
    ("osqp", "splitting with a slower factor: for small problems"),
    ("cvxpy_clarabel", "the same interior point on cones: takes group norms"),
)  # fmt: skip

#: Up to how many variables a member of `PREFERENCE` goes before later ones; beyond,
#: it is taken only when no other can
LARGEST = {name: 30_000 for name in ("clarabel", "piqp", "osqp", "cvxpy_clarabel")}


@functools.cache
def solvers() -> dict[str, Solver]:
    """Every solver by name, installed or not, ours before another package's."""
    found: dict[str, Solver] = {}
    for entry in importlib.metadata.entry_points(group=ENTRY_POINTS):
        found |= _of(_loaded(entry), f"entry point {entry.name} of {ENTRY_POINTS}")
    for module in pkgutil.iter_modules(ttus_opt.solvers.__path__):
        loaded = importlib.import_module(f"ttus_opt.solvers.{module.name}")
        if hasattr(loaded, "SOLVERS"):
            found |= _of(loaded, module.name)
    return dict(sorted(found.items()))


def candidates(solver: str | Path | Solver, program: Program) -> list[Solver]:
    """The solver that was asked for, or for "auto" those of `PREFERENCE` in turn.

    Args:
        solver: A name, "auto", the path of a file with ``SOLVERS``, or a solver.
        program: What it shall solve.

    Returns:
        Solvers that are installed and take the program, the one to try first in front.

    Raises:
        InputError: Unknown name, not a solver, or no solver takes the program.
        SolverUnavailableError: The one asked for is not installed.
    """
    if isinstance(solver, str) and solver == "auto":
        return _preferred(program)
    one = _asked_for(solver)
    one.require(program)
    return [one]


def _preferred(program: Program) -> list[Solver]:
    """Those of `PREFERENCE` that take a program, the one to try first in front."""
    known = solvers()
    able = [
        known[candidate]
        for candidate, _reason in PREFERENCE
        if known[candidate].installed and not known[candidate].refusal(program)
    ]
    size = program.n_variables
    within = [s for s in able if size <= LARGEST.get(s.name, size) and s.suits(program)]
    if able:
        return within or able
    raise InputError("no installed solver takes this problem: see ttus-opt solvers")


def _asked_for(solver: str | Path | Solver) -> Solver:
    """One solver by name, by path, or as it is."""
    if isinstance(solver, Solver):
        return solver
    if not isinstance(solver, str | Path):
        raise InputError(
            "solver takes a name, the path of a file, or an object of a class over "
            f"ttus_opt.solvers.base.Solver, got {solver!r}"
        )
    if Path(solver).suffix == ".py":
        return _in_file(Path(solver))
    known = solvers()
    if solver not in known:
        near = difflib.get_close_matches(str(solver), known, n=3, cutoff=0.4)
        hint = "did you mean" if near else "there are"
        raise InputError(
            f"unknown solver {str(solver)!r}, {hint} {', '.join(near or known)}? A "
            "file of your own ends in .py"
        )
    return known[str(solver)]


def _in_file(path: Path) -> Solver:
    """The first solver of a user's file."""
    if not path.exists():
        raise InputError(f"solver file not found: {path}: check the path")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path} cannot be loaded as a Python file")
    module = importlib.util.module_from_spec(spec)
    with told_by_line(f"solver file {path}"):
        spec.loader.exec_module(module)
    return next(iter(_of(module, f"solver file {path}").values()))


def _loaded(entry: importlib.metadata.EntryPoint) -> Any:
    with told_by_line(f"entry point {entry.name} of {ENTRY_POINTS}"):
        return entry.load()


def _of(offered: Any, owner: str) -> dict[str, Solver]:
    """Solvers by name, of a module with ``SOLVERS``, a list, a class or an object.

    Raises:
        InputError: There is no solver.
    """
    given = getattr(offered, "SOLVERS", offered)
    many = given if isinstance(given, list | tuple) else [given]
    found = [one() if isinstance(one, type) else one for one in many]
    if not found or not all(isinstance(one, Solver) for one in found):
        raise InputError(
            f"{owner} has no solvers: give it a list SOLVERS of objects of classes "
            "over ttus_opt.solvers.base.Solver"
        )
    return {one.name: one for one in found}


def choose(solver: str | Path | Solver, program: Program) -> Solver:
    """The first of `candidates`."""
    return candidates(solver, program)[0]
