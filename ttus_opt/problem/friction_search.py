"""The search for a friction coefficient, and for a presliding length where told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from ttus_opt.contact.friction import FRICTION, PRESLIDING
from ttus_opt.problem.declaration import Formulation, Search
from ttus_opt.problem.terms.drag import GlobalCoulomb
from ttus_opt.problem.terms.drag_estimate import DragEstimate
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm

#: Largest presliding length of a search, as a multiple of the estimate [–]
LONGEST = 4.0


def with_drag(declared: Formulation, drag: GlobalCoulomb) -> Formulation:
    """The formulation, without a search, with drag in its measured wrenches."""
    wrench = ForceTerm, TorqueTerm
    return Formulation(
        replace(t, drag=drag) if isinstance(t, wrench) else t for t in declared.terms
    )


def with_friction_search(
    guess: DragEstimate,
    given: Callable[[GlobalCoulomb], Formulation],
    largest: float,
    *,
    likely: bool = False,
) -> Formulation:
    """The formulation at an estimate of drag, to be searched from there.

    Args:
        guess: The estimate.
        given: The formulation with given drag; pickled with the result.
        largest: Largest μ [–].
        likely: Whether the minimum is taken to be near the estimate of μ.
    """
    first = min(guess.friction_coefficient, largest)
    rubbed = partial(_rubbed, guess.drag, given)
    where = first if likely else None
    return rubbed(first).with_search(
        Search(FRICTION, 0.0, largest, rubbed, None, where)
    )


def _rubbed(
    estimate: GlobalCoulomb, given: Callable[[GlobalCoulomb], Formulation], mu: float
) -> Formulation:
    """Of one μ, with a search for the presliding length where one was estimated."""
    drag, length = estimate.with_coefficient(mu), estimate.presliding
    if not length or drag.no_presliding:
        return given(drag)
    held, most = partial(_held, drag, given), LONGEST * length
    return given(drag).with_search(Search(PRESLIDING, 0.0, most, held, likely=length))


def _held(
    drag: GlobalCoulomb, given: Callable[[GlobalCoulomb], Formulation], bent: float
) -> Formulation:
    return given(drag.with_presliding(bent))
