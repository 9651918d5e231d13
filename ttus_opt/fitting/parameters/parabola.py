"""Quadratic model of J(v), the minimum of the objective, near its own minimum.

Fits one step apart give the gradient and the second derivatives of J by central
differences. Their error is bounded by the fits' duality gaps and rounding.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact.places import UNKNOWN, PlaceErrors
from ttus_opt.core.arrays import Array
from ttus_opt.fitting.parameters.identification import NO_SLOPE, PlaceRows
from ttus_opt.problem.solution import Solution, Status

#: Relative rounding error of J [–]
ROUNDING = 1e-12


@dataclass(frozen=True)
class Parabola:
    """J near its minimum.

    Attributes:
        centre: The central point, shape (k,).
        solution: The fit there.
        gradient: Gradient of J at the centre, shape (k,).
        curvature: Second derivatives of J, shape (k, k).
        noise: Error bound of the diagonal of the curvature, shape (k,).
        beside: The fits one step above and below, by parameter.
        step: Distance of these, shape (k,).
    """

    centre: Array
    solution: Solution = field(repr=False)
    gradient: Array
    curvature: Array
    noise: Array
    beside: tuple[tuple[Solution, Solution], ...] = field(repr=False)
    step: Array

    @classmethod
    def through(
        cls, fitted: Callable[[Array], Solution], centre: Array, step: Array
    ) -> Parabola | None:
        """Fit around a point; None where a fit is not solved.

        Args:
            fitted: The fit at given values.
            centre: The central point, shape (k,).
            step: Distance of the other fits, shape (k,).
        """
        k, error = len(centre), 0.0
        unit = np.eye(k, dtype=int)
        pairs = list(itertools.combinations(range(k), 2))
        places = [unit[0] * 0, *unit, *-unit, *(unit[i] + unit[j] for i, j in pairs)]
        solved: dict[tuple[int, ...], Solution] = {}
        # sorted, so that consecutive fits differ in the last parameters only
        for signs in sorted(tuple(place.tolist()) for place in places):
            solution = fitted(centre + np.array(signs) * step)
            if solution.status is not Status.SOLVED or solution.kkt is None:
                return None
            rounding = ROUNDING * abs(solution.objective)
            error = max(error, solution.kkt.gap + rounding)
            solved[signs] = solution

        def at(place: NDArray[np.int64]) -> float:
            return solved[tuple(place.tolist())].objective

        J = at(unit[0] * 0)
        plus, minus = (np.array([at(s * e) for e in unit]) for s in (1, -1))
        curvature = np.diag((plus - 2.0 * J + minus) / step**2)
        for i, j in pairs:
            mixed = (at(unit[i] + unit[j]) - plus[i] - plus[j] + J) / step[i] / step[j]
            curvature[i, j] = curvature[j, i] = mixed
        return cls(
            centre,
            solved[(0,) * k],
            (plus - minus) / (2.0 * step),
            curvature,
            4.0 * error / step**2,
            tuple((solved[tuple(e)], solved[tuple(-e)]) for e in unit),
            step,
        )

    @property
    def flat(self) -> NDArray[np.bool_]:
        """Parameters in which J has no significant curvature, shape (k,)."""
        flat = np.diagonal(self.curvature) <= 2.0 * self.noise
        if not flat.any() and np.linalg.eigvalsh(self.curvature)[0] <= 0.0:
            flat[:] = True
        return np.asarray(flat)

    @property
    def reason(self) -> str:
        """The reason to report for a flat parameter."""
        bent = (np.diagonal(self.curvature) < -2.0 * self.noise).any()
        return "the objective has no least value in its range" if bent else NO_SLOPE

    def errors(self, variance: float) -> Array:
        """Standard errors for a variance σ² of weighted rows, shape (k,)."""
        spread = 2.0 * variance * np.linalg.inv(self.curvature)
        return np.asarray(np.sqrt(np.diagonal(spread)))

    def place_errors(self, usual: Array, rows: PlaceRows | None) -> PlaceErrors:
        """Standard errors that allow for errors shared by a place.

        Args:
            usual: Those for independent rows, shape (k,).
            rows: The measured rows by place; None where unknown.
        """
        if rows is None:
            return PlaceErrors(usual, (UNKNOWN,) * len(usual))

        def residuals(solution: Solution) -> Array:
            assert solution.candidate is not None
            return rows.residuals(solution.program, solution.candidate)

        change = np.stack([residuals(a) - residuals(b) for a, b in self.beside], axis=1)
        inverse = np.asarray(np.linalg.inv(self.curvature))
        pull = change / (2.0 * self.step) @ inverse
        at = residuals(self.solution)
        return rows.errors(usual, at, pull, np.diagonal(inverse))

    @property
    def vertex(self) -> Array:
        """The minimum of the parabola, shape (k,)."""
        return np.asarray(self.centre - np.linalg.solve(self.curvature, self.gradient))
