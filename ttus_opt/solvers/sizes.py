"""Sizes of a program that are cheap to know, from which solvers estimate their cost.

An estimate only has to put solvers in order: `auto` takes the least. The constants that
solvers state were measured by ``benchmarks/solver_cost.py``, which also says how far
the choice is from the best one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.problem.program import Program
from ttus_opt.terms.penalties.linear import Linear

#: Entries of a split row of first differences; L's have nine, and splitting takes long
NARROW = 5.0


@dataclass(frozen=True)
class Sizes:
    """What decides how long a program takes.

    Attributes:
        voxels: Entries of all voxel fields [–].
        variables: Of x, auxiliary ones included [–].
        rows: Of all terms and constraints [–].
        measured: Rows of terms that are no Laplace prior of a field [–].
        limits: Inequality rows and variables with a bound [–].
        kinks: Rows of linear penalties; absolute values and Huber's reduce to them [–].
        width: Entries of a constraint's row, on average [–].
    """

    voxels: int
    variables: int
    rows: int
    measured: int
    limits: int
    kinks: int
    width: float

    @classmethod
    def of(cls, program: Program) -> Sizes:
        """Count; nothing is multiplied or factorised."""
        sizes = {name: s.stop - s.start for name, s in program.variables.items()}
        V = sizes["p"]
        fields = sum(size == V for size in sizes.values())
        held = [len(c.lower) for c in program.constraints]
        held += [len(c.offset) for c in program.cones]
        limits = sum(
            int((c.lower != c.upper).sum()) for c in program.constraints
        ) + sum(len(c.offset) for c in program.cones)
        if program.bounds:
            lower, upper = program.box
            limits += int((np.isfinite(lower) | np.isfinite(upper)).sum())
        terms = [(len(t.target), t) for t in program.terms]
        return cls(
            voxels=V * fields,
            variables=program.n_variables,
            rows=sum(m for m, _ in terms) + sum(held),
            measured=sum(m for m, t in terms if t.laplace_rows is None),
            limits=limits,
            kinks=sum(m for m, t in terms if isinstance(t.penalty, Linear)),
            width=sum(c.matrix.nnz for c in program.constraints) / max(sum(held), 1),
        )


def interior_point_seconds(program: Program) -> float:
    """Seconds of an interior point method on the sparse least-squares form.

    A factor of a three-dimensional grid costs the square of its voxels; without
    inequalities one step and one to confirm it are enough.

    Args:
        program: What it shall solve.
    """
    s = Sizes.of(program)
    steps = 13.0 if s.limits or s.kinks else 2.0
    return 0.05 + steps * (2.2e-9 * s.voxels**2 + 3e-6 * (s.variables + s.rows))


def splitting_seconds(program: Program) -> float:
    """Seconds of a splitting method that keeps one factor over all iterations.

    Args:
        program: What it shall solve.
    """
    s = Sizes.of(program)
    harder = 1.0 + min(s.limits / s.voxels, 2.0)
    if s.kinks > s.voxels:  # absolute values all over: of differences, or of L's rows
        harder = 3.5 if s.width <= NARROW else 10.0
    # kinks: many iterations, however small the grid
    return (1.0 if s.kinks else 0.08) + 1.5e-6 * harder * float(s.voxels**1.45)
