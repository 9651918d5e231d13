"""Reasons why solvers based on multigrid for L refuse a program."""

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
    """Why the terms are not sums of squares with a Laplace term; empty if they are."""
    prior = laplace_prior(program)
    if prior is None or prior.weight == 0.0:
        return "it needs a Laplace term"
    if not has_all_rows(prior) and hard_values(program) is None:
        return f"it takes {prior.name} only with hard boundary values"
    others = [t.name for t in program.terms if not t.is_squares]
    return f"{others[0]} is not a sum of squares" if others else ""


def refusal_of_unknowns(program: Program, most: int) -> str:
    """Why there are too many unknowns beside the field; empty if there are not."""
    others = program.n_variables - len(program.laplace.free)
    if others <= most:
        return ""
    return f"it takes at most {most} unknowns beside the field, got {others}"


def refusal_of_limits(program: Program) -> str:
    """Why the limits are not bounds or growth along spokes; empty if they are."""
    free, prior = program.laplace.free, laplace_prior(program)
    try:
        limits = SpokeLimits.of(program)
    except ValueError as error:
        return f"it takes bounds and growth along spokes: {error}"
    if not limits.binding:
        return ""
    if program.n_variables > len(free):
        return "it takes no limits of the field beside other unknowns"
    scale = None if prior is None else row_scale(prior)
    if prior is not None and scale is not None and (scale[free] != 1.0).any():
        return f"it takes {prior.name} only without limits of the field"
    return ""
