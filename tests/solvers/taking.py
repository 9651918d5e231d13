"""Which solver takes what, written down: tests run over this and never skip by it.

A solver that begins to refuse a problem, or to take one, fails `test_taking` until the
change is written here; a test that asked the solver itself would pass over it.
"""

from collections.abc import Mapping

import pytest

from ttus_opt.solvers.registry import solvers

#: Through cvxpy: penalties that are no sum of squares as they are written
CONES = frozenset({"cvxpy_clarabel", "cvxpy_mosek", "cvxpy_scs"})

#: Any convex quadratic program
QP = CONES | {
    "clarabel",
    "copt",
    "gurobi",
    "osqp",
    "piqp",
    "proxqp",
    "qpalm",
    "qtqp",
    "scs",
    "sip",
}

#: Sums of squares without limits
CLOSED = frozenset(
    {
        "closed_form",
        "closed_form_cholespy",
        "closed_form_cholmod",
        "closed_form_pardiso",
    }
)

#: Inequalities, through an active set; no lone equalities
HIGHS = frozenset({"highs"})

#: Laplace's rows and measured ones; amg_pcg takes those of the plain operator
STRUCTURED, AMG = frozenset({"structured"}), frozenset({"amg_pcg"})

#: A prior whose covariance is known
COVARIANCE = frozenset({"covariance"})

#: Penalties that are no sum of squares, as they were declared
BENT = frozenset({"augmented_lagrangian"})

#: Any sum of squares beside Laplace's rows
NORMAL = frozenset({"normal_equations"})

#: Any sum of squares without Laplace's rows
ALGEBRAIC = frozenset({"algebraic"})

#: Who takes the reduced program of a formulation of the shelf
FORMULATIONS: Mapping[str, frozenset[str]] = {
    "anisotropic": QP | CLOSED | STRUCTURED | NORMAL,
    "coulomb_drag": QP | HIGHS | STRUCTURED,
    "coulomb_global": QP | CLOSED | STRUCTURED | NORMAL | AMG,
    "depth_map": QP | CLOSED | COVARIANCE | ALGEBRAIC,
    "depth_map_coulomb": QP | CLOSED | COVARIANCE | ALGEBRAIC,
    "depth_map_residual": QP | CLOSED | STRUCTURED | NORMAL | AMG,
    "eq10": QP | CLOSED | STRUCTURED | NORMAL | AMG,
    "eq10_hard_boundary": QP | STRUCTURED | NORMAL,
    "eq10_monotone": QP | HIGHS | STRUCTURED | NORMAL,
    "eq10_sign": QP | HIGHS | STRUCTURED | NORMAL,
    "eq10_sign_monotone": QP | HIGHS | STRUCTURED | NORMAL,
    "free_surface": QP | HIGHS | STRUCTURED | NORMAL,
    "laplace_only": QP | CLOSED | STRUCTURED | NORMAL | AMG,
    "robust": QP | HIGHS | BENT,
    "screened": QP | CLOSED | STRUCTURED | NORMAL,
    "sparse_sources": QP | HIGHS | BENT,
    "tikhonov": QP | CLOSED | STRUCTURED | NORMAL,
    "total_variation": QP | HIGHS | BENT,
    "viscous_drag": QP | HIGHS | STRUCTURED,
    "volume_weighted": QP | STRUCTURED | NORMAL,
}

#: Who takes a reference problem, bent penalties reduced where that is possible
REFERENCES: Mapping[str, frozenset[str]] = {
    "least_squares": QP | CLOSED | ALGEBRAIC,
    "two_weights": QP | CLOSED | ALGEBRAIC,
    "box": QP | HIGHS | BENT,
    "weakly_active": QP | HIGHS | BENT,
    "equality": QP,
    "upper_row": QP | HIGHS | BENT,
    "lower_row": QP | HIGHS | BENT,
    "mixed_rows": QP | HIGHS | BENT,
    "names": QP | HIGHS | BENT,
    "linear_term": QP | HIGHS | BENT,
    "absolute": QP | HIGHS | BENT,
    "absolute_kink": QP | HIGHS | BENT,
    "huber": QP | HIGHS | BENT,
    "groups": CONES | BENT,
}

#: Who takes a small program without Laplace rows that has bounds
BOUNDED = QP | HIGHS | BENT

#: What a plain installation has; a solver beyond may be absent, and is named then
REQUIRED = {
    "algebraic",
    "amg_pcg",
    "clarabel",
    "closed_form",
    "cvxpy_clarabel",
    "normal_equations",
    "osqp",
    "structured",
}


def installed(takers):
    """Solvers of a set that are installed, by name."""
    return [s for name, s in solvers().items() if name in takers and s.installed]


def over(takers):
    """Decorator: the test for every installed solver of a set."""
    return pytest.mark.parametrize("solver", installed(takers), ids=lambda s: s.name)


def pairs(table, slow=()):
    """Every row of a table with every installed solver that takes it.

    Args:
        table: Solvers by problem.
        slow: Solvers and problems to be marked so.
    """
    return [
        pytest.param(
            solver,
            name,
            id=f"{solver.name}-{name}",
            marks=[pytest.mark.slow] if (solver.name, name) in slow else [],
        )
        for name, takers in table.items()
        for solver in installed(takers)
    ]


def named(items):
    """Names in order, for a comparison that can be read."""
    return sorted(items)
