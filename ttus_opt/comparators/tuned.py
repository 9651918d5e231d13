"""Eq. 10 with what the data say of weights, boundary scale and drag.

The same as ``ttus-opt fit`` where no weight is given: of `eq10` and `coulomb_global`
the one with the larger marginal likelihood, at its most likely weights, if presses left
out agree.
"""

from __future__ import annotations

from ttus_opt.comparators.field_model import FieldModel
from ttus_opt.fitting.batch import fit
from ttus_opt.fitting.weight_choice import choose_weights
from ttus_opt.problem.solution import Solution
from ttus_opt.scene import Scene


class Tuned(FieldModel):
    """The field of the most likely formulation and weights."""

    name = "tuned"
    summary = "ours: eq. 10, with drag or without, by marginal likelihood"
    turns = False  # its searches end within a tolerance

    def _solved(self, scene: Scene) -> Solution:
        choice = choose_weights(scene)
        return fit(choice.scene, choice.formulation)
