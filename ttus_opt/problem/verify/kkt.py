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

import functools
import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.problem.members import ProgramConstraint
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
    point = _digest(program, x, duals, tolerance)
    # a solver's own check is not repeated by the verdict
    residuals: KKT | None = program.judged.get(point)
    if residuals is None:
        with np.errstate(over="ignore", invalid="ignore"):
            residuals = _residuals(program, x, duals, tolerance)
        program.judged.clear()
        program.judged[point] = residuals
    return residuals if np.isfinite(residuals.worst_relative) else NOT_FINITE


@functools.lru_cache(maxsize=1)
def _probe(n: int) -> Array:
    """A vector whose products tell matrices apart, shape (n,)."""
    return np.random.default_rng(0).uniform(1.0, 2.0, n)


def _digest(program: Program, x: Array, duals: Duals, tolerance: float) -> bytes:
    """Hash of a point, its multipliers, the tolerance, and the program's arrays.

    The arrays may be views of a recording or of a matrix that is edited.
    For a matrix a product stands, which takes a fifth of the time of hashing it.
    """
    digest = hashlib.sha256(repr(tolerance).encode())
    parts: list[tuple[str, Array | None]] = [("x", x), ("bounds", duals.bounds)]
    probe = _probe(program.n_variables)
    matrices = [term.matrix for term in program.terms]
    matrices += [member.matrix for member in program.constraints]
    matrices += [cone.matrix for cone in program.cones]
    parts += [("matrix", matrix @ probe) for matrix in matrices]
    parts += [("target", term.target) for term in program.terms]
    limits = [(c.lower, c.upper) for c in program.constraints]
    limits += [(b.lower, b.upper) for b in program.bounds]
    parts += [("limit", values) for pair in limits for values in pair]
    parts += [("offset", cone.offset) for cone in program.cones]
    parts += [(f"row {name}", values) for name, values in duals.rows.items()]
    parts += [(f"term {name}", values) for name, values in duals.terms.items()]
    for name, values in parts:
        digest.update(repr((name, None if values is None else values.shape)).encode())
        if values is not None:
            digest.update(np.ascontiguousarray(values, dtype=float).data)
    return digest.digest()


def _residuals(program: Program, x: Array, duals: Duals, tolerance: float) -> KKT:
    blocks = GradientBlocks(program)
    multipliers = _of_terms(program, x, duals, blocks)
    gap = _of_bounds(program, x, duals, blocks)
    gap += _of_rows(program, x, duals, blocks)
    gap += _of_cones(program, x, duals, blocks)
    largest = float(np.abs(x).max(initial=0.0))
    violation, relative = worst_violation(program, x)
    fixed = held_by_equalities(program)
    # scale: the objective at x = 0, with the values that equalities fix
    objective, scale = program.objective(x), program.objective(np.where(fixed, x, 0.0))
    point = _Point(program, x, multipliers, blocks.gradient, fixed)
    bound = _without_loose(point, duals, tolerance * objective)
    if bound is None:
        missing, is_bound = point.below(tolerance * objective)
        gap += missing
    else:
        gap, is_bound = bound, True
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
    """Add the objective's gradient; return the multipliers of other penalties."""
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


def _without_loose(point: _Point, duals: Duals, goal: float) -> float | None:
    """The bound where auxiliary variables have no squares; None without any."""
    program, x = point.program, point.x
    loose = loose_variables(program, point.fixed)
    if not loose.any():
        return None
    given = {}
    for constraint in program.constraints:
        y = duals.rows.get(constraint.name, np.zeros(len(constraint.lower)))
        given[constraint.name], _ = _present(y, constraint.lower, constraint.upper)
    for cone in program.cones:
        y = duals.rows.get(cone.name, np.zeros(len(cone.offset)))
        given[cone.name] = cone.admissible(y)
    rows = exact_rows(program, given, loose)
    if rows is None:
        return None
    exact, blocks = Duals(rows, duals.bounds, duals.terms), GradientBlocks(program)
    multipliers = _of_terms(program, x, exact, blocks)
    gap = _of_bounds(program, x, exact, blocks) + _of_rows(program, x, exact, blocks)
    gap += _of_cones(program, x, exact, blocks)
    r = np.where(loose, 0.0, blocks.gradient)
    rest = energy(program, r, point.fixed | loose, CLOSE_ENOUGH * goal)
    if rest is None:
        return None
    there = replace(point, multipliers=multipliers, gradient=r)
    return gap + rest + there.fenchel() + there.held_off(r)


def _of_bounds(
    program: Program, x: Array, duals: Duals, blocks: GradientBlocks
) -> float:
    """Add the multipliers of bounds; return their part of the gap."""
    if not program.bounds:
        return 0.0
    lower, upper = program.box
    z = np.zeros_like(x) if duals.bounds is None else duals.bounds
    z, stray = _present(z, lower, upper)
    blocks.add(z)
    blocks.add_stray(stray)
    return _complementarity(z, lower, upper, x)


def _of_rows(program: Program, x: Array, duals: Duals, blocks: GradientBlocks) -> float:
    """Add the multipliers of linear rows; return their part of the gap."""
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
    """Add the multipliers of cones; return their part of the gap."""
    gap = 0.0
    for cone in program.cones:
        given = duals.rows.get(cone.name, np.zeros(len(cone.offset)))
        y = cone.admissible(given)
        blocks.add(cone.matrix.T @ y)
        blocks.add_stray(cone.matrix.T @ (given - y))
        gap += abs(float(y @ cone.value(x)))
    return gap


@dataclass(frozen=True)
class _Point:
    """A candidate with its dual residual.

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
        """The gap by r and other penalties, and whether it is a bound.

        Args:
            goal: The requested gap; a bound far below it is not tightened.
        """
        program, x, r = self.program, self.x, self.gradient
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


def _present(dual: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Multipliers of existing limits, and those of absent ones."""
    there = np.isfinite(np.where(dual > 0.0, upper, lower))
    return np.where(there, dual, 0.0), np.where(there, 0.0, dual)


def _complementarity(dual: Array, lower: Array, upper: Array, value: Array) -> float:
    """Σ |dual| · distance to its limit."""
    limit = np.where(dual > 0.0, upper, lower)
    limit = np.where(dual == 0.0, value, limit)
    return float(np.abs(dual * (limit - value)).sum())
