"""What the dual of eq. 10 needs of a program: the system, b and weighted targets."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.solvers.dual.system import DualSystem


@dataclass(frozen=True)
class DualData:
    """A program without its limits, seen from its dual.

    Attributes:
        system: The dual system of its terms and hard boundary values.
        b: Of L p = b, shape (V,).
        t: Weighted targets of the measured rows, shape (m,).
        columns: Weighted columns of the unknowns beside the field, shape (m, k).
    """

    system: DualSystem
    b: Array = field(repr=False)
    t: Array = field(repr=False)
    columns: Array = field(repr=False)

    @classmethod
    def of(cls, program: Program) -> DualData:
        """Read a program whose terms are a Laplace term and measured rows."""
        prior = laplace_prior(program)
        assert prior is not None
        return cls(*_dual_system(program, prior))


def laplace_prior(program: Program) -> ProgramTerm | None:
    """The term that holds p by L's rows alone, as they are or scaled."""
    term = program.laplace_term_of("p")
    rows = None if term is None else term.laplace_rows
    return None if rows is None or rows.beside else term


def row_scale(prior: ProgramTerm) -> Array | None:
    """What L's free rows are multiplied by, shape (V,); None where they are all L's."""
    rows = prior.laplace_rows
    return None if rows is None else rows.scale


def hard_values(program: Program) -> Array | None:
    """Hard Dirichlet values in the order of the fixed voxels; None where soft."""
    given = program.dirichlet
    return None if given is None else given.lower


def root_weights(program: Program) -> Array:
    """Roots of the measured rows' weights over the prior's, shape (m,) [–]."""
    prior = laplace_prior(program)
    assert prior is not None
    roots = [
        np.full(len(t.target), np.sqrt(t.weight / prior.weight))
        for t in _measured(program, prior)
    ]
    return np.concatenate([*roots, np.zeros(0)])


def _measured(program: Program, prior: ProgramTerm) -> list[ProgramTerm]:
    """The terms beside the prior that count."""
    return [t for t in program.terms if t is not prior and t.weight > 0.0]


def _right_side(program: Program, prior: ProgramTerm) -> Array:
    """Vector b of L p = b, from scaled free rows and hard boundary values."""
    free, hard, scale = program.laplace.free, hard_values(program), row_scale(prior)
    if scale is None:
        b = prior.target.copy()
    else:  # such a term has free rows only, its boundary values are hard
        b = np.empty(len(free))
        b[free] = prior.target / scale[free]
    if hard is not None:
        b[~free] = hard
    return b


def _dual_system(
    program: Program, prior: ProgramTerm
) -> tuple[DualSystem, Array, Array, Array]:
    """The dual system of a program, b, weighted targets and weighted columns."""
    measured = _measured(program, prior)
    V = len(program.laplace.free)
    compliance, scale = np.ones(V), row_scale(prior)
    if scale is not None:
        compliance /= scale**2
    if hard_values(program) is not None:
        compliance[~program.laplace.free] = 0.0
    root = root_weights(program)
    empty = sp.csr_array((0, program.n_variables))
    rows = sp.csr_array(sp.vstack([empty, *(t.matrix for t in measured)], format="csr"))
    target = root * np.concatenate([*(t.target for t in measured), np.zeros(0)])
    columns = root[:, None] * rows[:, V:].toarray()
    own = rows if rows.shape[1] == V else sp.csr_array(rows[:, :V])
    system = DualSystem(program.laplace, compliance, own, root)
    return system, _right_side(program, prior), target, columns
