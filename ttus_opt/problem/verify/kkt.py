"""KKT residuals of an answer, computed here and never taken from a solver.

For minimise ½xᵀPx + qᵀx subject to lower ≤ A x ≤ upper and lb ≤ x ≤ ub the duals y
(rows) and z (bounds) are positive at an active upper limit and negative at a lower one;
those of absent limits count as zero:

    primal  violation of the limits by A x and x
    dual    r = P x + q + Aᵀy + z = 0
    gap     f(x) minus the optimum, or a bound of it

Rows s = A x + h in second-order cones, which are self-dual, have a multiplier y with −y
in the cones: it adds Aᵀy to r and −yᵀs ≥ 0 to the gap; the distance of s from its cones
belongs to ``primal``.

A penalty φ that is not quadratic has a multiplier g of its residual, projected onto the
set of φ's subgradients; it adds w Mᵀg to r and w (φ(r) + φ*(g) − gᵀr) ≥ 0 to the gap
(Fenchel), which is zero exactly where g is a subgradient of φ at r.

Gap: Σ |y| · slack + Fenchel + ½ rᵀP⁻¹r, a bound by weak duality
(`problem.verify.distance`). Where squares do not determine x, the other penalties'
multipliers absorb r, which gives another bound (`problem.verify.absorption`). Over
auxiliary variables, which have no squares, r must vanish: the bound is that of nearby
multipliers for which it does (`problem.verify.loose_columns`). Without any of these,
the customary |rᵀx|, summed over blocks of variables, replaces the last summand; it is
not a bound.

Relative figures are those of the worst block (the field, a parameter, a second field)
or member: ``primal`` over the member's largest limit or value, at least a thousandth of
the summands of its rows; ``dual`` in the Euclidean norm over the largest of the block's
summands; ``gap`` over the objective f(x), constant included. Where the objective is
zero up to rounding, √gap over √f of x = 0 (with the values fixed by equalities) takes
its place, a hundred times as strict.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.problem.members import (
    ProgramCones,
    ProgramConstraint,
    complementarity,
    of_existing,
)
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.absorption import CLOSE_ENOUGH, absorbed
from ttus_opt.problem.verify.distance import energy, held_by_equalities
from ttus_opt.problem.verify.loose_columns import exact_rows, loose_variables
from ttus_opt.problem.verify.relative_residuals import (
    TINY,
    GradientBlocks,
    largest_of,
    quadratic_summands,
    worst_violation,
)


@dataclass(frozen=True)
class Duals:
    """Multipliers by constraint name, signs as in the module's docstring.

    Attributes:
        rows: y per linear constraint and per set of cones, shape (m,) each.
        bounds: z of the box, shape (n,); None without bounds.
        terms: g per term whose penalty is neither squares nor linear, shape (m,) each;
            by default the subgradient of least length.
    """

    rows: Mapping[str, Array] = field(default_factory=dict)
    bounds: Array | None = None
    terms: Mapping[str, Array] = field(default_factory=dict)

    def of(self, member: ProgramConstraint | ProgramCones) -> Array:
        """The y of linear rows or of cones, zero where it is missing, shape (m,)."""
        return self.rows.get(member.name, np.zeros(member.matrix.shape[0]))


def bound_duals(program: Program, bounds: Array | None) -> dict[str, Array]:
    """Split the box's multipliers by the name of the active bound.

    Args:
        program: The program.
        bounds: z, shape (n,); None for zero.

    Returns:
        Multipliers by name of the bound, shape of its variable each.
    """
    z = np.zeros(program.n_variables) if bounds is None else bounds
    lower, upper = program.box
    above, below = np.maximum(z, 0.0), np.minimum(z, 0.0)
    duals = {}
    for bound in program.bounds:
        # the tightest limit has the multiplier, the first one among equals
        holds = bound.upper == upper
        reaches = bound.lower == lower
        duals[bound.name] = (above * holds + below * reaches)[bound.part]
        above, below = above * ~holds, below * ~reaches
    return duals


@dataclass(frozen=True)
class KKT:
    """Residuals of the optimality conditions.

    Attributes:
        primal: Largest violation of a limit [the limit's unit].
        dual: Norm of the Lagrangian's gradient.
        gap: Bound or estimate of the objective's excess over the optimum.
        primal_relative: Violation over the largest finite limit or row value, worst
            member [–].
        dual_relative: Gradient over the largest of its summands, worst block of
            variables [–].
        gap_relative: ``gap`` over the objective [–].
        distance: Bound of (Σ w ‖M (x − x*)‖²)^½ over the sums of squares [root of the
            objective's unit]; None if ``gap`` is not a bound.
    """

    primal: float
    dual: float
    gap: float
    primal_relative: float
    dual_relative: float
    gap_relative: float
    distance: float | None = None

    @property
    def worst_relative(self) -> float:
        """The largest relative residual [–]."""
        return largest_of(self.primal_relative, self.dual_relative, self.gap_relative)

    @property
    def is_bound(self) -> bool:
        """Whether ``gap`` is a bound, so that the solver's claim is not needed."""
        return self.distance is not None

    def as_dict(self) -> dict[str, float | None]:
        """All residuals by name, for JSON."""
        return asdict(self)


#: Residuals of an answer that is not finite
NOT_FINITE = KKT(*([float("inf")] * 6))

#: Factor by which a distance is judged more strictly than a relative gap [–]
STRICTER = 100.0


def kkt_residuals(
    program: Program, x: Array, duals: Duals, *, tolerance: float = 1e-6
) -> KKT:
    """Residuals of the optimality conditions of a program.

    Args:
        program: The program.
        x: A candidate, shape (n,).
        duals: Its multipliers; missing ones count as zero.
        tolerance: A bound of the relative gap far below this is not tightened [–].

    Returns:
        The residuals; infinite where the candidate, a multiplier or a result is not
        finite.
    """
    given = [x, *duals.rows.values(), *duals.terms.values()]
    given += [] if duals.bounds is None else [duals.bounds]
    if not all(np.isfinite(values).all() for values in given):
        return NOT_FINITE
    with np.errstate(over="ignore", invalid="ignore"):
        residuals = _residuals(program, x, duals, tolerance)
    return residuals if np.isfinite(residuals.worst_relative) else NOT_FINITE


def _residuals(program: Program, x: Array, duals: Duals, tolerance: float) -> KKT:
    point = _Point.of(program, x, duals, held_by_equalities(program))
    violation, relative = worst_violation(program, x)
    # scale: the objective at x = 0, with the values that equalities fix
    objective = program.objective(x)
    scale = program.objective(np.where(point.fixed, x, 0.0))
    gap, is_bound = _without_loose(point, duals, tolerance * objective), True
    if gap is None:
        missing, is_bound = point.below(tolerance * objective)
        gap = point.complementarity + missing
    return KKT(
        violation,
        point.blocks.error,
        gap,
        relative,
        point.blocks.worst(float(np.abs(x).max(initial=0.0))),
        _relative_gap(gap, objective, scale),
        float(np.sqrt(gap)) if is_bound else None,
    )


@dataclass(frozen=True)
class _Point:
    """A candidate with its multipliers.

    Attributes:
        program: The program.
        x: Shape (n,).
        fixed: Variables that equalities hold, shape (n,).
        blocks: The summands of the Lagrangian's gradient r.
        multipliers: g of other penalties, by name.
        complementarity: Part of the gap by the multipliers of limits.
    """

    program: Program
    x: Array
    fixed: Mask
    blocks: GradientBlocks
    multipliers: Mapping[str, Array]
    complementarity: float

    @classmethod
    def of(cls, program: Program, x: Array, duals: Duals, fixed: Mask) -> _Point:
        """Add up the gradient of the Lagrangian."""
        blocks, multipliers, gap = GradientBlocks(program), {}, 0.0
        for summand in quadratic_summands(program, x):
            blocks.add(summand)
        for term in program.terms:
            if term.penalty.quadratic:
                continue
            g = duals.terms.get(term.name)
            if g is None:
                g = term.penalty.subgradient(term.residual(x))
            multipliers[term.name] = term.penalty.admissible(g)
            blocks.add(term.weight * (term.matrix.T @ multipliers[term.name]))
        if program.bounds:
            lower, upper = program.box
            given = np.zeros_like(x) if duals.bounds is None else duals.bounds
            z = of_existing(given, lower, upper)
            blocks.add(z)
            blocks.add_stray(given - z)
            gap += complementarity(z, lower, upper, x)
        for member in program.limited_rows:
            given = duals.of(member)
            y = member.admissible(given)
            blocks.add(member.matrix.T @ y)
            blocks.add_stray(member.matrix.T @ (given - y))
            gap += member.complementarity(y, x)
        return cls(program, x, fixed, blocks, multipliers, gap)

    def below(self, goal: float) -> tuple[float, bool]:
        """The gap by r and other penalties, and whether it is a bound.

        Args:
            goal: The requested gap; a bound far below it is not tightened.
        """
        program, x, r = self.program, self.x, self.blocks.gradient
        bound = energy(program, r, self.fixed, CLOSE_ENOUGH * goal)
        if bound is not None:
            return bound + self.fenchel() + self.held_off(r), True
        found = absorbed(program, x, self.multipliers, r, self.fixed, goal)
        if found is not None:
            return found.gap + self.held_off(r - found.taken), True
        parts = program.variables.values()
        shares = sum(abs(float(r[part] @ x[part])) for part in parts)
        return shares + self.fenchel(), False

    def held_off(self, r: Array) -> float:
        """Contribution of fixed variables, which move only by their violation."""
        return sum(_held(c, self.x, r) for c in self.program.constraints)

    def fenchel(self) -> float:
        """Σ w (φ(r) + φ*(g) − gᵀr)."""
        gap = 0.0
        for term in self.program.terms:
            if not term.penalty.quadratic:
                r, g = term.residual(self.x), self.multipliers[term.name]
                missing = term.penalty.value(r) + term.penalty.conjugate(g)
                gap += term.weight * max(missing - float(g @ r), 0.0)
        return gap


def _without_loose(point: _Point, duals: Duals, goal: float) -> float | None:
    """The gap where auxiliary variables have no squares; None without any."""
    program, fixed = point.program, point.fixed
    loose = loose_variables(program, fixed)
    if not loose.any():
        return None
    given = {m.name: m.admissible(duals.of(m)) for m in program.limited_rows}
    rows = exact_rows(program, given, loose)
    if rows is None:
        return None
    exact = _Point.of(program, point.x, replace(duals, rows=rows), fixed)
    r = np.where(loose, 0.0, exact.blocks.gradient)
    rest = energy(program, r, fixed | loose, CLOSE_ENOUGH * goal)
    if rest is None:
        return None
    return exact.complementarity + rest + exact.fenchel() + exact.held_off(r)


def _held(constraint: ProgramConstraint, x: Array, r: Array) -> float:
    """Σ |r| · violation over the rows that fix a variable."""
    at = constraint.fixing
    rows = constraint.matrix[at]
    column, entry = rows.indices, rows.data
    off = entry * x[column] - constraint.lower[at]
    return float(np.abs(r[column] / entry * off).sum())


def _relative_gap(gap: float, objective: float, scale: float) -> float:
    """The gap over the objective, or the strict distance over ``scale``."""
    by_objective = gap / max(abs(objective), TINY)
    by_distance = STRICTER * math.sqrt(gap / max(abs(scale), TINY))
    either = by_objective + by_distance  # Python's ``min`` lets NaN pass
    return float("inf") if math.isnan(either) else min(by_objective, by_distance)
