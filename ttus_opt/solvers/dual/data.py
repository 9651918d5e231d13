"""The data of the dual of eq. 10 from a program: system, b and weighted targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.members import ProgramTerm, StackedTerms
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.solvers.dual.system import DualSystem


@dataclass(frozen=True)
class DualData:
    """The dual of a program without its limits.

    Attributes:
        system: The dual system of its terms and hard boundary values.
        b: Right-hand side of L p = b, shape (V,).
        t: Weighted targets of the measured rows, shape (m,).
        columns: Weighted columns of the unknowns beside the field, shape (m, k).
    """

    system: DualSystem
    b: Array = field(repr=False)
    t: Array = field(repr=False)
    columns: Array = field(repr=False)

    @classmethod
    def of(
        cls, program: Program, measured: Sequence[ProgramTerm] | None = None
    ) -> DualData:
        """Extract the data of a program of a Laplace term and measured rows.

        Args:
            program: The program.
            measured: Terms to include; None for all except the Laplace term.
        """
        prior = program.laplace_prior
        assert prior is not None
        declared = prior.laplace_rows
        assert declared is not None
        if measured is None:
            measured = terms_beside(program, prior)
        free, hard, scale = program.laplace.free, program.dirichlet, declared.scale
        V = len(free)
        compliance = np.ones(V) if scale is None else 1.0 / scale**2
        b, stated = np.empty(V), np.ones(V, dtype=bool) if prior.has_all_rows else free
        b[stated] = prior.target if scale is None else prior.target / scale[stated]
        if hard is not None:
            b[~free], compliance[~free] = hard.lower, 0.0
        stacked = StackedTerms.of(measured, program.n_variables, prior.weight)
        rows, root = stacked.matrix, stacked.root
        columns = root[:, None] * rows[:, V:].toarray()
        own = sp.csr_array(rows if rows.shape[1] == V else rows[:, :V])
        laplace = declared.system or program.laplace
        system = DualSystem(laplace, compliance, own, root)
        return cls(system, b, root * stacked.target, columns)


def second_field(program: Program) -> tuple[str, ProgramTerm] | None:
    """Name and Laplace term of a second field; None without one."""
    for name in program.variables:
        term = None if name == "p" else program.laplace_term_of(name)
        rows = None if term is None else term.laplace_rows
        if term is not None and rows is not None and rows.scale is None:
            return name, term
    return None


def root_weights(program: Program) -> Array:
    """Square roots of the measured rows' weights over the prior's, shape (m,) [–]."""
    prior = program.laplace_prior
    assert prior is not None
    measured = terms_beside(program, prior)
    return StackedTerms.of(measured, program.n_variables, prior.weight).root


def terms_beside(program: Program, *priors: ProgramTerm) -> list[ProgramTerm]:
    """The terms of positive weight other than some."""
    return [t for t in program.terms if not any(t is p for p in priors) and t.weight]


def duals_without_limits(program: Program, x: Array) -> Duals:
    """Multipliers of given values of p and of bounds of other unknowns.

    Args:
        program: A program without other limits.
        x: The answer, shape (n,).
    """
    given, V = program.dirichlet, len(program.laplace.free)
    if given is None and not program.bounds:
        return Duals()
    slope = -np.add(*program.gradient(x))
    rows = {}
    if given is not None:
        rows[given.name] = slope[:V][~program.laplace.free]
    lower, upper = program.box
    z = np.where(x <= lower, np.minimum(slope, 0.0), 0.0)
    z += np.where(x >= upper, np.maximum(slope, 0.0), 0.0)
    z[:V] = 0.0
    return Duals(rows, z if program.bounds else None)


def refusal_of_terms(program: Program) -> str:
    """Why the terms are not sums of squares with a Laplace term; empty if they are."""
    prior = program.laplace_prior
    if prior is None or prior.weight == 0.0:
        return "it needs a Laplace term"
    if not prior.has_all_rows and program.dirichlet is None:
        return f"it takes {prior.name} only with hard boundary values"
    others = [t.name for t in program.terms if not t.is_squares]
    return f"{others[0]} is not a sum of squares" if others else ""


#: Most unknowns beside the field: each costs an approximate dual solve
MOST_BESIDE = 64


def refusal_of_unknowns(program: Program) -> str:
    """Why there are too many unknowns beside the field; empty if there are not."""
    others = program.n_variables - len(program.laplace.free)
    if others <= MOST_BESIDE:
        return ""
    return f"it takes at most {MOST_BESIDE} unknowns beside the field, got {others}"
