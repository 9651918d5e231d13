"""What `ttus_opt.fitting.weights.tuning` finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ttus_opt.contact.scene import Scene
from ttus_opt.problem.formulation import Formulation

#: Name of the hyperparameter that stands for the first term's weight
SIGNAL_TO_NOISE = "signal_to_noise"


@dataclass(frozen=True)
class Hyperparameter:
    """An estimated hyperparameter.

    Attributes:
        name: Its name.
        value: The value that is used.
        prior_value: The prior's median.
        spread: Posterior standard deviation of the logarithm; of the value itself for a
            coefficient or a boundary scale [–].
        determined: Whether the data tell more than its prior.
        at_bound: Whether the value lies at the end of its range.
    """

    name: str
    value: float
    prior_value: float
    spread: float
    determined: bool
    at_bound: bool = False


@dataclass(frozen=True)
class Comparison:
    """The choice by another criterion.

    Attributes:
        criterion: ``log_evidence`` or ``gcv``.
        weights: λ by term: the tuned ones times a common factor [–].
        left_out_force_error: Mean error of forces at places left out with them [N].
    """

    criterion: str
    weights: Mapping[str, float]
    left_out_force_error: float


@dataclass(frozen=True)
class Check:
    """Errors at places left out, with the weights chosen and the formulation's own.

    Attributes:
        model: The formulation.
        places: Number of places [–].
        chosen_error: Mean over places of the mean length of f - f̂ [N].
        own_error: The same with the formulation's own weights [N].
        difference_error: Standard error of their difference, over the places [N].
    """

    model: str
    places: int
    chosen_error: float
    own_error: float
    difference_error: float

    def __str__(self) -> str:
        gain = self.own_error - self.chosen_error
        what = "better than" if gain > 0.0 else "worse than"
        if abs(gain) <= self.difference_error:
            what = "about as well as"
        return (
            f"{self.model} with the weights chosen predicts places left out {what} with"
            f" its own weights ({self.chosen_error:.3f} N, {self.own_error:.3f} N, "
            f"their difference ± {self.difference_error:.2g} N over {self.places} "
            "places)"
        )


@dataclass(frozen=True)
class Tuning:
    """Result of `tune`; ``fit(tuning.scene, tuning.formulation)`` uses it.

    Attributes:
        formulation: With the chosen weights and options.
        scene: With the chosen boundary scale.
        hyperparameters: All estimated hyperparameters.
        weights: λ by term, for a fit that assumes independent frames [–].
        noise: Root mean square error of a component of the first term's rows at places
            left out; of forces, in N.
        check: Comparison with the formulation's own weights.
        comparisons: The choices by other criteria.
        candidates: Mean error of forces at places left out of all candidates, by name
            [N].
        shape: Shape of the grid for tuning.
        seconds: Time spent [s].
    """

    formulation: Formulation
    scene: Scene = field(repr=False)
    hyperparameters: tuple[Hyperparameter, ...]
    weights: Mapping[str, float]
    noise: float
    check: Check
    comparisons: tuple[Comparison, ...]
    candidates: Mapping[str, float]
    shape: tuple[int, ...]
    seconds: float = field(compare=False)

    @property
    def left_out_force_error(self) -> float:
        """Mean error of forces at places left out in turn [N]."""
        return self.check.chosen_error

    @property
    def not_determined(self) -> tuple[str, ...]:
        """Hyperparameters that the data hardly tell."""
        return tuple(h.name for h in self.hyperparameters if not h.determined)

    @property
    def weight_factors(self) -> Mapping[str, float]:
        """Exponential of the standard deviation of the logarithm of λ, by term [–]."""
        spread = {h.name: h.spread for h in self.hyperparameters}
        first = next(iter(self.weights), "")
        return {
            name: float(
                np.exp(
                    np.hypot(
                        spread[SIGNAL_TO_NOISE],
                        spread.get(ratio_name(name, first), 0.0),
                    )
                )
            )
            for name in self.weights
        }


def ratio_name(term: str, first: str) -> str:
    """Name of the hyperparameter that is a term's weight over the first's."""
    return f"{term}_over_{first}_weight"
