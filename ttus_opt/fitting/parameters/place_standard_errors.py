"""Standard errors of fitted parameters that allow for errors shared by a place.

The residuals of a few fits beside the optimum, which any solver may make, give their
derivatives along the profile (`ttus_opt.contact.place_errors`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from ttus_opt.contact.place_errors import PlaceErrors, place_errors
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.problem.program import Program


@dataclass(frozen=True)
class PlaceRows:
    """The measured rows of a program, by place.

    Attributes:
        names: Measured terms.
        rows: Their rows in contact, as each term has them, shape (r,) [–].
        place: Place of each of these, shape (r,) [–].
    """

    names: tuple[str, ...]
    rows: IntArray = field(repr=False)
    place: IntArray = field(repr=False)

    @classmethod
    def of(cls, scene: Scene, program: Program) -> Self | None:
        """The rows of a scene's measurements.

        Returns:
            None where rows are not squares, three per frame: their places are unknown.
        """
        terms = [t for t in program.terms if t.is_measured and t.weight > 0.0]
        n = 3 * len(scene.trajectory)
        if not all(t.is_squares and len(t.target) in (0, n) for t in terms):
            return None
        used = [term for term in terms if len(term.target)]
        rows = np.flatnonzero(np.repeat(scene.touching, 3))
        place = np.repeat(scene.places, 3)[rows]
        return cls(tuple(term.name for term in used), rows, place)

    def residuals(self, program: Program, x: Array) -> Array:
        """√λ (M x - t) of a fit, one term after the other, shape (m,)."""
        terms = [t for t in program.terms if t.name in self.names]
        each = [np.sqrt(t.weight) * t.residual(x)[self.rows] for t in terms]
        return np.concatenate([*each, np.zeros(0)])

    def errors(
        self, usual: Array, rest: Array, pull: Array, scale: Array
    ) -> PlaceErrors:
        """Standard errors by places, as `place_errors`."""
        place = np.tile(self.place, len(self.names))
        return place_errors(usual, rest, pull, scale, place)
