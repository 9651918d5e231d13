"""Optimality of an answer, computed here and never taken from a solver.

For minimise ½xᵀPx + qᵀx subject to lower ≤ A x ≤ upper and lb ≤ x ≤ ub the duals y
(rows) and z (bounds) are positive where an upper limit holds x back, negative at a
lower limit; those of the wrong sign, at a limit that is not there, count as zero:

    primal  how far A x and x lie outside their limits
    dual    r = P x + q + Aᵀy + z = 0
    gap     how far below f(x) the optimum may lie

Rows s = A x + h in second-order cones have a multiplier y with −y in the cones, which
are their own duals: it adds Aᵀy to r and −yᵀs ≥ 0 to the gap; how far s lies outside
its cones belongs to ``primal``.

A penalty φ that is not quadratic has a multiplier g of its residual, brought back
into the set of φ's subgradients; it adds w Mᵀg to r and w (φ(r) + φ*(g) − gᵀr) ≥ 0 to
the gap (Fenchel), which vanish together exactly where g is a subgradient of φ at r.

Gap: Σ |y| · slack + Fenchel + ½ rᵀP⁻¹r, a bound by weak duality
(`ttus_opt.problem.distance`). Where squares do not determine x the other penalties'
multipliers absorb r, which gives another bound (`ttus_opt.problem.absorption`). Where
there is neither, |rᵀx| of every block of variables stands for the last summand, which
is customary and no bound.

Relative figures, each by the worst block (the field, each parameter, each second
field) or member, so that none hides behind a larger one: ``primal`` over the member's
largest limit or value, no less than a thousandth of what cancels in its rows; ``dual``
in the Euclidean norm over the largest of the block's summands that should cancel;
``gap`` over the objective f(x), constant included. An objective that is zero but for
rounding has no relative gap; there the distance √gap is judged, a hundred times as
strictly, over √f of nothing fitted (x = 0 but for what equalities hold).
"""

from __future__ import annotations

import hashlib
import math
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from ttus_opt.arrays import Array, Mask
from ttus_opt.problem.absorption import CLOSE_ENOUGH, absorbed
from ttus_opt.problem.distance import energy, held_by_equalities
from ttus_opt.problem.gradient_blocks import (
    ROUNDING,
    TINY,
    GradientBlocks,
    largest_of,
    quadratic_summands,
)
from ttus_opt.problem.members import ProgramConstraint
from ttus_opt.problem.program import Program


@dataclass(frozen=True)
class Duals:
    """Multipliers by constraint name, signs as in the module's docstring.

    Attributes:
        rows: y per linear constraint and per set of cones, shape (m,) each.
        bounds: z of the box, shape (n,); None where nothing is bounded.
        terms: g per term whose penalty is neither squares nor linear, shape (m,)
            each; the subgradient of least length where it is missing.
    """

    rows: Mapping[str, Array] = field(default_factory=dict)
    bounds: Array | None = None
    terms: Mapping[str, Array] = field(default_factory=dict)


def bound_duals(program: Program, bounds: Array | None) -> dict[str, Array]:
    """Split the box's multipliers by the name of the bound that holds x back.

    Args:
        program: Whose bounds they are.
        bounds: z, shape (n,); None counts as zero.

    Returns:
        Per named bound the multipliers of its variable, shape of the variable.
    """
    z = np.zeros(program.n_variables) if bounds is None else bounds
    lower, upper = program.box
    above, below = np.maximum(z, 0.0), np.minimum(z, 0.0)
    found = {}
    for bound in program.bounds:
        # the tightest limit carries the multiplier; of equals the first takes it
        holds = bound.upper == upper
        reaches = bound.lower == lower
        found[bound.name] = (above * holds + below * reaches)[bound.part]
        above, below = above * ~holds, below * ~reaches
    return found


@dataclass(frozen=True)
class KKT:
    """Residuals of the optimality conditions.

    Attributes:
        primal: Largest violation of a limit [the limit's unit].
        dual: Norm of the Lagrangian's gradient.
        gap: How far below the objective at x the optimum may lie.
        primal_relative: Violation over the largest finite limit or row value, worst
            member [–].
        dual_relative: Gradient over the largest of its summands, worst block of
            variables [–].
        gap_relative: ``gap`` over the objective [–].
        distance: Bound on (Σ w ‖M (x − x*)‖²)^½ over the sums of squares, the unit of
            the objective's root; None where ``gap`` is no bound.
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
        """Whether ``gap`` is a bound, so that no solver's word is needed."""
        return self.distance is not None

    def as_dict(self) -> dict[str, float | None]:
        """All residuals by name, for JSON."""
        return asdict(self)


#: Of an answer that has no residuals
NOT_FINITE = KKT(*([float("inf")] * 6))

#: Rows whose values are a smaller part of their summands cancel: theirs is no size [–]
CANCELLED = 1e-3

#: How much stricter a distance is judged than a relative gap [–]
STRICTER = 100.0


def kkt_residuals(
    program: Program, x: Array, duals: Duals, *, tolerance: float = 1e-6
) -> KKT:
    """Residuals of the optimality conditions of a program.

    Args:
        program: The program.
        x: A candidate, shape (n,).
        duals: Its multipliers; missing ones count as zero.
        tolerance: Where the gap is far below this, relative, its bound need not come
            closer [–].

    Returns:
        The residuals; infinite where the candidate, a multiplier or what follows from
        them is not finite.
    """
    given = [x, *duals.rows.values(), *duals.terms.values()]
    given += [] if duals.bounds is None else [duals.bounds]
    if not all(np.isfinite(values).all() for values in given):
        return NOT_FINITE
    point = _digest(x, duals, tolerance)
    kept = _last.get(id(program))
    if kept is None or kept[0] != point:
        with np.errstate(over="ignore", invalid="ignore"):
            found = _residuals(program, x, duals, tolerance)
        if id(program) not in _last:
            weakref.finalize(program, _last.pop, id(program), None)
        _last[id(program)] = kept = point, found
    found = kept[1]
    return found if np.isfinite(found.worst_relative) else NOT_FINITE


#: By a program's identity the last point judged, and its residuals: a solver that asks
#: whether it is done need not be judged twice; they live as long as the program
_last: dict[int, tuple[bytes, KKT]] = {}


def _digest(x: Array, duals: Duals, tolerance: float) -> bytes:
    """What tells a point, its multipliers and the tolerance from all others."""
    found = hashlib.sha256(repr(tolerance).encode())
    told: list[tuple[str, Array | None]] = [("x", x), ("bounds", duals.bounds)]
    told += [(f"row {name}", values) for name, values in duals.rows.items()]
    told += [(f"term {name}", values) for name, values in duals.terms.items()]
    for name, values in told:
        found.update(repr((name, None if values is None else values.shape)).encode())
        if values is not None:
            found.update(np.ascontiguousarray(values, dtype=float).data)
    return found.digest()


def _residuals(program: Program, x: Array, duals: Duals, tolerance: float) -> KKT:
    blocks = GradientBlocks(program)
    multipliers = _of_terms(program, x, duals, blocks)
    gap = _of_bounds(program, x, duals, blocks)
    gap += _of_rows(program, x, duals, blocks)
    gap += _of_cones(program, x, duals, blocks)
    largest = float(np.abs(x).max(initial=0.0))
    violation = relative = 0.0
    for member in _members(program, x):
        violation = largest_of(violation, member.violation)
        relative = largest_of(relative, member.relative(ROUNDING * largest))
    fixed = held_by_equalities(program)
    # with nothing fitted: equalities keep what they hold, all else is zero
    objective, scale = program.objective(x), program.objective(np.where(fixed, x, 0.0))
    point = _Point(program, x, multipliers, blocks.gradient, fixed)
    missing, is_bound = point.below(tolerance * objective)
    gap += missing
    return KKT(
        violation,
        blocks.error,
        gap,
        relative,
        blocks.worst(largest),
        _relative_gap(gap, objective, scale),
        float(np.sqrt(gap)) if is_bound else None,
    )


def _of_terms(
    program: Program, x: Array, duals: Duals, blocks: GradientBlocks
) -> dict[str, Array]:
    """Add the objective's gradient; the multipliers of other penalties, by name."""
    for summand in quadratic_summands(program, x):
        blocks.add(summand)
    found = {}
    for term in program.terms:
        if term.penalty.quadratic:
            continue
        g = duals.terms.get(term.name)
        if g is None:
            g = term.penalty.subgradient(term.residual(x))
        found[term.name] = term.penalty.admissible(g)
        blocks.add(term.weight * (term.matrix.T @ found[term.name]))
    return found


def _of_bounds(
    program: Program, x: Array, duals: Duals, blocks: GradientBlocks
) -> float:
    """Add the multipliers of bounds; their part of the gap."""
    if not program.bounds:
        return 0.0
    lower, upper = program.box
    z = np.zeros_like(x) if duals.bounds is None else duals.bounds
    z, stray = _present(z, lower, upper)
    blocks.add(z)
    blocks.add_stray(stray)
    return _complementarity(z, lower, upper, x)


def _of_rows(program: Program, x: Array, duals: Duals, blocks: GradientBlocks) -> float:
    """Add the multipliers of linear rows; their part of the gap."""
    gap = 0.0
    for constraint in program.constraints:
        y = duals.rows.get(constraint.name, np.zeros(len(constraint.lower)))
        y, stray = _present(y, constraint.lower, constraint.upper)
        blocks.add(constraint.matrix.T @ y)
        blocks.add_stray(constraint.matrix.T @ stray)
        value = constraint.matrix @ x
        gap += _complementarity(y, constraint.lower, constraint.upper, value)
    return gap


def _of_cones(
    program: Program, x: Array, duals: Duals, blocks: GradientBlocks
) -> float:
    """Add the multipliers of cones; their part of the gap."""
    gap = 0.0
    for cone in program.cones:
        given = duals.rows.get(cone.name, np.zeros(len(cone.offset)))
        y = cone.admissible(given)
        blocks.add(cone.matrix.T @ y)
        blocks.add_stray(cone.matrix.T @ (given - y))
        gap += abs(float(y @ cone.value(x)))
    return gap


def _members(program: Program, x: Array) -> Iterator[_Member]:
    """What must lie between limits, or in cones, at x."""
    for b in program.bounds:
        yield _Member(x[b.part], b.lower[b.part], b.upper[b.part])
    for c in program.constraints:
        entries = np.abs(c.matrix.data * x[c.matrix.indices])
        size = CANCELLED * float(entries.max(initial=0.0))
        yield _Member(c.matrix @ x, c.lower, c.upper, size)
    for cone in program.cones:  # its rows' limits are the nearest point of the cones
        s = cone.value(x)
        nearest = cone.projected(s)
        yield _Member(s, nearest, nearest)


@dataclass(frozen=True)
class _Point:
    """A candidate, and what is left of the Lagrangian's gradient there.

    Attributes:
        program: The program.
        x: Shape (n,).
        multipliers: g of other penalties, by name.
        gradient: r, shape (n,).
        fixed: Variables that equalities hold, shape (n,).
    """

    program: Program
    x: Array
    multipliers: Mapping[str, Array]
    gradient: Array
    fixed: Mask

    def below(self, goal: float) -> tuple[float, bool]:
        """What r and other penalties leave of the objective, and whether it bounds.

        Args:
            goal: The gap that is asked for: far below it the bound need not be close.
        """
        program, x, r = self.program, self.x, self.gradient
        bound = energy(program, r, self.fixed, CLOSE_ENOUGH * goal)
        if bound is not None:
            return bound + self._fenchel() + self._held_off(r), True
        found = absorbed(program, x, self.multipliers, r, self.fixed, goal)
        if found is not None:
            return found.gap + self._held_off(r - found.taken), True
        parts = program.variables.values()
        shares = sum(abs(float(r[part] @ x[part])) for part in parts)
        return shares + self._fenchel(), False

    def _held_off(self, r: Array) -> float:
        """What equalities hold cannot move but by their own violation."""
        held = (_held(c, self.x, r, self.fixed) for c in self.program.constraints)
        return sum(held)

    def _fenchel(self) -> float:
        """Σ w (φ(r) + φ*(g) − gᵀr)."""
        gap = 0.0
        for term in self.program.terms:
            if not term.penalty.quadratic:
                r, g = term.residual(self.x), self.multipliers[term.name]
                missing = term.penalty.value(r) + term.penalty.conjugate(g)
                gap += term.weight * max(missing - float(g @ r), 0.0)
        return gap


def _held(constraint: ProgramConstraint, x: Array, r: Array, fixed: Mask) -> float:
    """Σ |r| · violation over the rows that fix a variable."""
    single = np.diff(constraint.matrix.indptr) == 1
    at = np.flatnonzero(single & (constraint.lower == constraint.upper))
    if not len(at):
        return 0.0
    start = constraint.matrix.indptr[at]
    column, entry = constraint.matrix.indices[start], constraint.matrix.data[start]
    off = entry * x[column] - constraint.lower[at]
    return float(np.abs(r[column] / entry * off).sum())


def _relative_gap(gap: float, objective: float, scale: float) -> float:
    """The gap over the objective, or strictly over that of nothing fitted."""
    if gap == 0.0:
        return 0.0
    by_objective = gap / max(abs(objective), TINY)
    by_distance = STRICTER * math.sqrt(gap / max(abs(scale), TINY))
    either = by_objective + by_distance  # Python's ``min`` lets NaN pass
    return float("inf") if math.isnan(either) else min(by_objective, by_distance)


@dataclass(frozen=True)
class _Member:
    """Values of one constraint or bound between its limits."""

    value: Array
    lower: Array
    upper: Array
    least: float = 0.0  # size that rows have whose summands cancel

    @property
    def violation(self) -> float:
        """Largest excess over a limit."""
        if not len(self.value):
            return 0.0
        below, above = self.lower - self.value, self.value - self.upper
        return largest_of(float(np.max(below)), float(np.max(above)), 0.0)

    def relative(self, least: float) -> float:
        """The same over the largest finite limit or value [–].

        Args:
            least: What counts at least as that: values of a member that are all
                zero but for rounding have no size of their own.
        """
        violation = self.violation
        if not violation:
            return 0.0
        sizes = np.abs([self.value, self.lower, self.upper])
        span = float(sizes[np.isfinite(sizes)].max(initial=0.0))
        return violation / largest_of(span, self.least, least, TINY)


def _present(dual: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Multipliers of limits that are there, and those of limits that are not."""
    there = np.isfinite(np.where(dual > 0.0, upper, lower))
    return np.where(there, dual, 0.0), np.where(there, 0.0, dual)


def _complementarity(dual: Array, lower: Array, upper: Array, value: Array) -> float:
    """Σ |dual| · distance to its limit."""
    limit = np.where(dual > 0.0, upper, lower)
    limit = np.where(dual == 0.0, value, limit)
    return float(np.abs(dual * (limit - value)).sum())
