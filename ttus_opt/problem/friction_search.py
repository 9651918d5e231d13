"""The search for a friction coefficient, and for a presliding length where told."""

from __future__ import annotations

from collections.abc import Callable

from ttus_opt.contact.friction import FRICTION, PRESLIDING
from ttus_opt.problem.declaration import Formulation, Search
from ttus_opt.problem.terms.drag import GlobalCoulomb
from ttus_opt.problem.terms.drag_estimate import DragEstimate

#: Largest presliding length of a search, as a multiple of the estimate [–]
LONGEST = 4.0


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
        given: The formulation with given drag.
        largest: Largest μ [–].
        likely: Whether the minimum is taken to be near the estimate of μ.
    """
    first, length = min(guess.friction_coefficient, largest), guess.drag.presliding

    def rubbed(mu: float) -> Formulation:
        drag = guess.drag.with_coefficient(mu)
        declared = given(drag)
        if not length or drag.no_presliding:
            return declared

        def held(bent: float) -> Formulation:
            return given(drag.with_presliding(bent))

        most = LONGEST * length
        return declared.with_search(Search(PRESLIDING, 0.0, most, held, likely=length))

    where = first if likely else None
    return rubbed(first).with_search(
        Search(FRICTION, 0.0, largest, rubbed, None, where)
    )
