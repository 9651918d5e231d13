"""Reduction of penalties with a `Split` to quadratic programs with more variables.

With above, below ≥ 0 per row (r = M x - t), for instance

    Huber     φ(r) = min  ‖r − above + below‖² + 2δ Σ (above + below)
    absolute  φ(r) = min  Σ (above + below)   over   r = above − below

`Reduction.restore` returns x, the duals of the original program by name, and the
multipliers of the penalties.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.members import ProgramBounds, ProgramConstraint, ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.penalties import Linear
from ttus_opt.problem.terms.rows import unit_rows
from ttus_opt.problem.verify.kkt import Duals


@dataclass(frozen=True)
class Point:
    """A point of the original program.

    Attributes:
        x: All its variables, shape (n,).
        duals: Its multipliers.
    """

    x: Array
    duals: Duals


@dataclass(frozen=True)
class Reduction:
    """A program and its equivalent reduced form.

    Attributes:
        original: As declared.
        program: Without penalties that have a `Split`; the original itself if it has
            none.
    """

    original: Program
    program: Program

    def restore(self, x: Array, duals: Duals) -> Point:
        """A point of the original program from variables and duals of the reduced."""
        if self.program is self.original:
            return Point(x, duals)
        n = self.original.n_variables
        original = {constraint.name for constraint in self.original.constraints}
        original |= {cone.name for cone in self.original.cones}
        rows = {name: y for name, y in duals.rows.items() if name in original}
        terms = dict(duals.terms)
        for term in self.original.terms:
            y = duals.rows.get(_split_name(term.name))
            if y is not None and term.weight > 0.0:
                terms[term.name] = term.penalty.admissible(y / term.weight)
        bounds = None
        if self.original.bounds and duals.bounds is not None:
            bounds = duals.bounds[:n]
        return Point(x[:n], Duals(rows, bounds, terms))

    def lift(self, x: Array, duals: Duals) -> Point:
        """A point of the reduced program from variables and duals of the original."""
        if self.program is self.original:
            return Point(x, duals)
        n = self.original.n_variables
        wide = np.concatenate([x, np.zeros(self.program.n_variables - n)])
        z = np.zeros_like(wide)
        if duals.bounds is not None:
            z[:n] = duals.bounds
        rows = dict(duals.rows)
        for term in self.original.terms:
            split = term.penalty.split
            if split is None:
                continue
            r = term.residual(x)
            g = duals.terms.get(term.name, term.penalty.subgradient(r))
            rest = 0.5 * g if split.squares_rest else np.zeros_like(r)
            for side, sign in (("above", 1.0), ("below", -1.0)):
                part = self.program.variables[f"{term.name}:{side}"]
                wide[part] = np.maximum(sign * (r - rest), 0.0)
                z[part] = np.minimum(term.weight * (sign * g - split.slope), 0.0)
            if not split.squares_rest:
                rows[_split_name(term.name)] = term.weight * g
        return Point(wide, Duals(rows, z, duals.terms))


def reduce(program: Program) -> Reduction:
    """Reduce penalties that have a `Split`; others stay as they are.

    New members are named after their term: variables ``term:above`` and ``term:below``,
    bound ``term:excess`` and, for absolute values, the rows ``term:split``.
    """
    lifted = [term for term in program.terms if term.penalty.split is not None]
    if not lifted:
        return Reduction(program, program)
    variables = dict(program.variables)
    n = program.n_variables
    for term in lifted:
        m = len(term.target)
        for side in ("above", "below"):
            variables[f"{term.name}:{side}"] = slice(n, n + m)
            n += m
    terms: list[ProgramTerm] = []
    free = np.full(n - program.n_variables, np.inf)
    rows = [replace(c, matrix=_widened(c.matrix, n)) for c in program.constraints]
    bounds = [
        replace(b, lower=np.append(b.lower, -free), upper=np.append(b.upper, free))
        for b in program.bounds
    ]
    for term in program.terms:
        split = term.penalty.split
        if split is None:
            terms.append(replace(term, matrix=_widened(term.matrix, n)))
            continue
        start = variables[f"{term.name}:above"].start
        parts = _split_rows(term.matrix, start, n)
        name = term.name
        if split.squares_rest:
            terms.append(ProgramTerm(name, term.weight, parts, term.target))
            name = f"{name}:excess"
        else:
            rows.append(
                ProgramConstraint(_split_name(name), parts, term.target, term.target)
            )
        # the cost of above + below, which are not negative
        both = slice(start, start + 2 * len(term.target))
        unit, zero = unit_rows(np.arange(n)[both], n), np.zeros(2 * len(term.target))
        slope, lower = split.slope * term.weight, np.full(n, -np.inf)
        terms.append(ProgramTerm(name, slope, unit, zero, Linear()))
        lower[both] = 0.0
        excess = f"{term.name}:excess"
        bounds.append(ProgramBounds(excess, lower, np.full(n, np.inf), both))
    reduced = replace(
        program,
        variables=variables,
        terms=tuple(terms),
        constraints=tuple(rows),
        bounds=tuple(bounds),
        cones=tuple(replace(c, matrix=_widened(c.matrix, n)) for c in program.cones),
        declared=program,
    )
    return Reduction(program, reduced)


def _split_name(term: str) -> str:
    return f"{term}:split"


def _widened(matrix: sp.csr_array, n: int) -> sp.csr_array:
    """The same rows with empty columns at the end; no copy."""
    shape = (matrix.shape[0], n)
    return sp.csr_array((matrix.data, matrix.indices, matrix.indptr), shape=shape)


def _split_rows(matrix: sp.csr_array, start: int, n: int) -> sp.csr_array:
    """Rows M x − above + below."""
    m, width = matrix.shape
    unit = sp.eye_array(m, format="csr")
    before = sp.csr_array((m, start - width))
    after = sp.csr_array((m, n - start - 2 * m))
    return sp.csr_array(sp.hstack([matrix, before, -unit, unit, after]))
