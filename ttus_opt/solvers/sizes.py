"""Sizes of a program, from which solvers estimate their cost.

An estimate only has to rank solvers, as "auto" takes the cheapest. The constants were
measured by ``benchmarks/solver_cost.py``, which also compares the choice with the best
one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.penalties import Linear

#: Most entries per row of first differences, split; split rows of L have nine and take
#: longer
NARROW = 5.0


@dataclass(frozen=True)
class Sizes:
    """Sizes that determine the time of a solve.

    Attributes:
        voxels: Entries of all voxel fields [–].
        variables: Entries of x, auxiliary ones included [–].
        rows: Rows of all terms and constraints [–].
        measured: Rows of terms other than Laplace priors [–].
        limits: Inequality rows and bounded variables [–].
        kinks: Rows of linear penalties, to which absolute values and Huber's are
            reduced [–].
        width: Mean entries per row of the constraints [–].
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
        """Count rows and entries."""
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

    A factor on a three-dimensional grid costs the square of its voxels; without
    inequalities, one step and another to confirm it suffice.
    """
    s = Sizes.of(program)
    steps = 13.0 if s.limits or s.kinks else 2.0
    return 0.05 + steps * (2.2e-9 * s.voxels**2 + 3e-6 * (s.variables + s.rows))


def splitting_seconds(program: Program) -> float:
    """Seconds of a splitting method with one factor for all iterations."""
    s = Sizes.of(program)
    harder = 1.0 + min(s.limits / s.voxels, 2.0)
    if s.kinks > s.voxels:  # absolute values everywhere: of differences, or of L's rows
        harder = 3.5 if s.width <= NARROW else 10.0
    # kinks: many iterations, however small the grid
    return (1.0 if s.kinks else 0.08) + 1.5e-6 * harder * float(s.voxels**1.45)
