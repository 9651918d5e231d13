"""Warn where the recordings tell no friction (`problem.terms.distinct_drag`)."""

from __future__ import annotations

import warnings

from ttus_opt.core.errors import TtusWarning
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.distinct_drag import ONE_SENSE


def warn_of_untold_friction(declared: Formulation, done: str, depth: int = 1) -> None:
    """Warn that friction of a formulation cannot be told from an elastic force.

    Args:
        declared: Nothing is said of formulations for which this is not so, or whose
            coefficient is given.
        done: What is done about it.
        depth: Calls above the calling function to which the warning points.
    """
    unknowns = {name for term in declared.terms for name in term.assembled.blocks}
    if declared.search is None and unknowns == {"p"}:
        return
    reasons = declared.not_identifiable().items()
    named = ", ".join(name for name, why in reasons if why == ONE_SENSE)
    if named:
        warnings.warn(
            f"{declared.name}: {named} cannot be told from an elastic force "
            f"({ONE_SENSE}): {done}; record the release of every press too, or slide "
            "the probe along the skin",
            TtusWarning,
            stacklevel=depth + 2,
        )
