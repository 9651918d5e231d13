"""The solvers there are, found by looking into this folder, and which one to take.

A backend is added by adding a file with a list ``SOLVERS``.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import pkgutil

import ttus_opt.solvers
from ttus_opt.errors import InputError
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Solver

#: What ``solver="auto"`` tries, in this order, and why. The first that is installed
#: and takes the program is chosen.
PREFERENCE: tuple[tuple[str, str], ...] = (
    ("structured", "never forms Q: exact to rounding and the fastest at every size, "
     "while the measured rows are fewer than half the voxels"),
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
    """Every solver by name, installed or not."""
    found: dict[str, Solver] = {}
    for module in pkgutil.iter_modules(ttus_opt.solvers.__path__):
        loaded = importlib.import_module(f"ttus_opt.solvers.{module.name}")
        for solver in getattr(loaded, "SOLVERS", ()):
            found[solver.name] = solver
    return dict(sorted(found.items()))


def candidates(name: str, program: Program) -> list[Solver]:
    """The solver of that name, or for "auto" those of `PREFERENCE` to try in turn.

    Args:
        name: A solver's name or "auto".
        program: What it shall solve.

    Returns:
        Solvers that are installed and take the program, the one to try first in front.

    Raises:
        InputError: Unknown name, or no solver takes the program.
        SolverUnavailableError: The one asked for is not installed.
    """
    known = solvers()
    if name == "auto":
        able = [
            known[candidate]
            for candidate, _reason in PREFERENCE
            if known[candidate].installed and not known[candidate].refusal(program)
        ]
        size = program.n_variables
        within = [
            s for s in able if size <= LARGEST.get(s.name, size) and s.suits(program)
        ]
        if able:
            return within or able
        raise InputError("no installed solver takes this problem: see ttus-opt solvers")
    if name not in known:
        near = difflib.get_close_matches(name, known, n=3, cutoff=0.4)
        raise InputError(
            f"unknown solver {name!r}, {'did you mean' if near else 'there are'} "
            f"{', '.join(near or known)}?"
        )
    known[name].require(program)
    return [known[name]]


def choose(name: str, program: Program) -> Solver:
    """The first of `candidates`."""
    return candidates(name, program)[0]
