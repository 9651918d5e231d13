"""All solvers, found by looking into this folder and `packages`; the choice of one.

``solver="auto"`` takes the solver with the least estimated cost (`Solver.cost`).

To add a backend, add a file with a list ``SOLVERS``; another package offers its own by
an entry point of the group ``ttus_opt.solvers``, a user by path or as an object.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import math
import pkgutil
from pathlib import Path
from typing import Any

import ttus_opt.solvers
import ttus_opt.solvers.packages
from ttus_opt.core.errors import InputError
from ttus_opt.core.plugins import module_of_file, unknown_name, user_errors
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Solver

#: Where another package offers solvers
ENTRY_POINTS = "ttus_opt.solvers"


@functools.cache
def solvers() -> dict[str, Solver]:
    """Every solver by name, installed or not, ours before another package's."""
    found: dict[str, Solver] = {}
    for entry in importlib.metadata.entry_points(group=ENTRY_POINTS):
        owner = f"entry point {entry.name} of {ENTRY_POINTS}"
        with user_errors(owner):
            offered = entry.load()
        found |= _of(offered, owner)
    for folder in (ttus_opt.solvers, ttus_opt.solvers.packages):
        for module in pkgutil.iter_modules(folder.__path__):
            loaded = importlib.import_module(f"{folder.__name__}.{module.name}")
            if hasattr(loaded, "SOLVERS"):
                found |= _of(loaded, module.name)
    return dict(sorted(found.items()))


def candidates(solver: str | Path | Solver, program: Program) -> list[Solver]:
    """The requested solver, or for "auto" all that estimate their cost.

    Args:
        solver: A name, "auto", the path of a file with ``SOLVERS``, or a solver.
        program: The program to solve.

    Returns:
        Installed solvers that take the program, in the order in which to try them.

    Raises:
        InputError: Unknown name, not a solver, or no solver takes the program.
        SolverUnavailableError: The requested solver is not installed.
    """
    if isinstance(solver, str) and solver == "auto":
        return _preferred(program)
    one = asked_for(solver)
    one.require(program)
    return [one]


def _preferred(program: Program) -> list[Solver]:
    """Solvers that take a program and estimate its cost, the cheapest first.

    Raises:
        InputError: There is none, or the program is too large for all (`excess`).
    """
    costs: list[tuple[float, Solver]] = []
    for known in solvers().values():
        if known.installed and (why := known.excess(program)):
            raise InputError(
                f"solver {known.name} alone takes such a problem in less than hours, "
                f"and {why}"
            )
        if known.installed and not known.refusal(program):
            with user_errors(f"solver {known.name}"):
                costs.append((known.cost(program), known))
    able = [(cost, solver) for cost, solver in costs if cost < math.inf]
    if able:
        return [solver for _, solver in sorted(able, key=lambda pair: pair[0])]
    raise InputError("no installed solver takes this problem: see ttus-opt solvers")


def estimating() -> list[str]:
    """Names of the solvers that "auto" considers, in alphabetical order."""
    return [s.name for s in solvers().values() if s.estimates]


def asked_for(solver: str | Path | Solver) -> Solver:
    """One solver by name, by path, or as it is.

    Raises:
        InputError: There is no such solver.
    """
    if isinstance(solver, Solver):
        return solver
    if not isinstance(solver, str | Path):
        raise InputError(
            "solver takes a name, the path of a file, or an instance of a subclass of "
            f"ttus_opt.solvers.base.Solver, got {solver!r}"
        )
    if Path(solver).suffix == ".py":
        offered = module_of_file(Path(solver), "solver")
        return next(iter(_of(offered, f"solver file {solver}").values()))
    known = solvers()
    if str(solver) not in known:
        raise unknown_name("solver", str(solver), known)
    return known[str(solver)]


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
            f"{owner} has no solvers: give it a list SOLVERS of instances of "
            "subclasses of ttus_opt.solvers.base.Solver"
        )
    return {one.name: one for one in found}


def choose(solver: str | Path | Solver, program: Program) -> Solver:
    """The first of `candidates`."""
    return candidates(solver, program)[0]
