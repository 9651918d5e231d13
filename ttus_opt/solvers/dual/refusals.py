"""What the solvers that build on L⁻¹ by multigrid cannot take, in words."""

from __future__ import annotations

from ttus_opt.problem.program import Program
from ttus_opt.solvers.dual.data import (
    hard_values,
    has_all_rows,
    laplace_prior,
    row_scale,
)
from ttus_opt.solvers.dual.limits import SpokeLimits


def refusal_of_terms(program: Program) -> str:
    """Sums of squares, one of them a Laplace term; empty where it is that."""
    prior = laplace_prior(program)
    if prior is None or prior.weight == 0.0:
        return "it needs a Laplace term"
    if not has_all_rows(prior) and hard_values(program) is None:
        return f"it takes {prior.name} with hard boundary values only"
    bent = [t.name for t in program.terms if not t.is_squares]
    return f"it takes sums of squares only, {bent[0]} is none" if bent else ""


def refusal_of_unknowns(program: Program, most: int) -> str:
    """Unknowns beside the field, up to a number; empty where there are no more."""
    others = program.n_variables - len(program.laplace.free)
    if others <= most:
        return ""
    return f"it takes {most} unknowns beside the field, these are {others}"


def refusal_of_limits(program: Program) -> str:
    """Bounds and growth along spokes, of the field alone; empty where they are that."""
    free, prior = program.laplace.free, laplace_prior(program)
    try:
        limits = SpokeLimits.of(program)
    except ValueError as error:
        return f"it takes bounds and growth along spokes: {error}"
    if not limits.binding:
        return ""
    if program.n_variables > len(free):
        return "it takes no limits of the field where there are other unknowns"
    scale = None if prior is None else row_scale(prior)
    if prior is not None and scale is not None and (scale[free] != 1.0).any():
        return f"it takes {prior.name} without bounds only"
    return ""
