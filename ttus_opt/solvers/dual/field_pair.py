"""Two fields, the second of which is at most a share of the first.

For two fields p and q with a Laplace prior each, `structured` handles bounds of both
and Coulomb's limit, q between 0 and μ p. In the variables x = σ p and y = σ q/μ, with
σ = 1 inside and -1 outside (which no row of L couples), this is one link x - y ≥ s per
voxel: the pair of a voxel is treated like a spoke of two voxels (`limits`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.problem.members import ProgramConstraint, ProgramTerm, StackedTerms
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.solvers.dual.active_set import LimitedProblem
from ttus_opt.solvers.dual.data import duals_without_limits, second_field, terms_beside
from ttus_opt.solvers.dual.limits import (
    Multipliers,
    SpokeLimits,
    row_limits,
    two_entries,
)
from ttus_opt.solvers.dual.pair_subproblem import PairRows, PairSubproblem
from ttus_opt.solvers.dual.touched_limits import TouchedLimits
from ttus_opt.solvers.dual.working_set import WorkingSet

#: Relative difference below which ratios count as equal [–]
SAME = 1e-12


@dataclass(frozen=True)
class FieldPair(LimitedProblem):
    """Two fields of a program in the units and signs of their limits.

    Attributes:
        prior: The second field's Laplace term.
        places: Indices of p and q among the program's unknowns, shape (2V,).
        others: Index of an unknown beside them, shape (1,) or (0,).
        units: Factors from x and y to p and q, shape (2V,).
    """

    prior: ProgramTerm
    places: IntArray = field(repr=False)
    others: IntArray = field(repr=False)
    units: Array = field(repr=False)
    links_along_spokes: ClassVar[bool] = False
    alone: ClassVar[bool] = False

    @classmethod
    def of(cls, program: Program) -> FieldPair:
        """Read a program.

        Args:
            program: The problem.

        Raises:
            ValueError: It is not such a problem; the message says why.
        """
        second = second_field(program)
        if second is None:
            raise ValueError("there is no second field with a Laplace term")
        name, prior = second
        first = program.laplace_term
        if first is None or first.weight == 0.0 or prior.weight == 0.0:
            raise ValueError("each field needs a Laplace term of positive weight")
        every = np.arange(program.n_variables)
        places = np.concatenate([every[program.variables[k]] for k in ("p", name)])
        beside = np.ones(len(every), dtype=bool)
        beside[places] = False
        others = np.flatnonzero(beside)
        V = len(places) // 2
        if len(others) > 1:
            raise ValueError(
                f"at most one unknown beside two fields, got {len(others)}"
            )
        region = program.laplace.voxmap.grid.flatten(program.laplace.voxmap.region)
        sign = np.where(region < 0, -1.0, 1.0)
        linear = [c for c in program.constraints if c is not program.dirichlet]
        read = {c.name: _links(c, program.variables[name].start, V) for c in linear}
        ratio = _common_ratio([r for _, _, r in read.values()])
        units = np.concatenate([sign, ratio * sign])
        links, least = {}, np.full(2 * V, -np.inf)
        for member in linear:
            at, factor, _ = read[member.name]
            scale = factor * sign[at]
            bound, other = row_limits(member, scale)
            if np.isfinite(other).any():
                raise ValueError(f"{member.name} limits {name} on the other side too")
            least[at] = np.maximum(least[at], bound)
            links[member.name] = (at, scale, bound)
        lower, upper, given = _box(program, places)
        ends = lower / units, upper / units
        ends = np.minimum(*ends), np.maximum(*ends)
        limits = SpokeLimits((2, V, 1), *ends, given, least, links)
        return cls(program, limits, prior, places, others, units)

    @cached_property
    def rows(self) -> PairRows:
        """The objective of x and y."""
        program, prior, units = self.program, self.prior, self.units
        first, laplace = program.laplace_term, program.laplace
        assert first is not None
        V = len(laplace.free)
        one = sp.diags_array(units[:V])
        L = sp.csr_array(one @ laplace.L @ one)
        compliance = np.ones(2 * V)
        compliance[V:] = first.weight / prior.weight / units[V:] ** 2
        beside = np.zeros(program.n_variables)
        beside[self.others] = 1.0
        column = np.concatenate([t.matrix @ beside for t in (first, prior)]) / units
        b = np.concatenate([first.target, prior.target]) / units
        given = self.limits.given
        compliance[given], column[given] = 0.0, 0.0
        b[given] = self.limits.lower[given]
        measured = terms_beside(program, first, prior)
        stacked = StackedTerms.of(measured, len(beside), first.weight)
        matrix, root = stacked.matrix, stacked.root
        return PairRows(
            laplace,
            sp.csr_array(sp.block_diag((L, L), format="csr")),
            compliance,
            b,
            column,
            sp.csr_array(matrix[:, self.places] @ sp.diags_array(units)),
            root,
            root * stacked.target,
            root * (matrix @ beside),
            self.bounds,
        )

    def subproblem(self, active: WorkingSet) -> PairSubproblem:
        """The problem of a working set."""
        return PairSubproblem(self.rows, self.limits, active)

    @cached_property
    def _touched(self) -> TouchedLimits | None:
        """Model of the limits where measured rows touch the second field, or None."""
        V = len(self.limits.given) // 2
        limited = np.isfinite(self.limits.lower) & ~self.limits.given
        return TouchedLimits.of(self.rows, limited[V:])

    def predicted(
        self, active: WorkingSet, p: Array, signs: Multipliers
    ) -> WorkingSet | None:
        """The next working set by `TouchedLimits`; None if that changes nothing."""
        model, first = self._touched, self.program.laplace_term
        if model is None or first is None:
            return None
        at = len(p) // 2 + model.voxels
        if (active.bounds[at] > 0).any():
            return None
        z = -signs.bounds[at] / (2.0 * first.weight)
        beside = self.rows.parameter_and_slope(p)
        held = model.active((p - self.limits.lower)[at], z, beside)
        if held is None:
            return None
        bounds = active.bounds.copy()
        bounds[at] = -held.astype(np.int8)
        following = WorkingSet(bounds, active.links)
        return following if following.differs(active) else None

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the unknown beside the fields."""
        lower, upper = (limit[self.others] for limit in self.program.box)
        return float(lower.max(initial=-np.inf)), float(upper.min(initial=np.inf))

    def objective(self, p: Array) -> float:
        """The objective, minimised over the unknown beside the fields."""
        return self.program.objective(self.variables(p))

    def gradient(self, p: Array) -> Array:
        """Its gradient, shape (2V,)."""
        full = np.add(*self.program.gradient(self.variables(p)))
        return np.asarray(self.units * full[self.places])

    def limited(self, x: Array) -> Array:
        """Both fields in the units of their limits, shape (2V,)."""
        return np.asarray(x[self.places] / self.units)

    def variables(self, p: Array) -> Array:
        """The program's unknowns: both fields and the optimal unknown beside them."""
        x = np.zeros(self.program.n_variables)
        x[self.places] = self.units * p
        x[self.others] = self.rows.parameter(p)
        return x

    def duals(self, x: Array | None, signs: Multipliers) -> Duals:
        """As `LimitedProblem.duals`; that of the unknown beside follows from x."""
        named = dict(self.limits.duals(signs).rows)
        z = np.zeros(self.program.n_variables)
        z[self.places] = signs.bounds / self.units
        beside = None if x is None else duals_without_limits(self.program, x).bounds
        if beside is not None:
            z[self.others] = beside[self.others]
        dirichlet = self.program.dirichlet
        if dirichlet is not None:
            fixed = np.flatnonzero(~self.program.laplace.free)
            named[dirichlet.name] = z[fixed]
            z[fixed] = 0.0
        return Duals(named, z if self.program.bounds else None)


def _links(
    constraint: ProgramConstraint, start: int, n_voxels: int
) -> tuple[IntArray, Array, Array]:
    """Voxels v of rows a (p_v - q_v/μ), with a and μ."""
    pairs = two_entries(constraint.matrix)
    if pairs is not None:
        (at, other), (a, b) = pairs[0].T, pairs[1].T
        opposed = (at < n_voxels) & (other == at + start) & (a * b < 0.0)
        if opposed.all() and np.bincount(at).max(initial=0) <= 1:
            return at, a, -a / b
    raise ValueError(f"{constraint.name} is neither a bound nor a share of the field")


def _common_ratio(ratios: list[Array]) -> float:
    """The common μ of all rows; 1 without rows."""
    every = np.concatenate([*ratios, np.zeros(0)])
    if not len(every):
        return 1.0
    if np.ptp(every) > SAME * every.max():
        raise ValueError("the share of the field differs between voxels")
    return float(every[0])


def _box(program: Program, places: IntArray) -> tuple[Array, Array, Mask]:
    """Bounds of both fields, and where they prescribe a Dirichlet value."""
    lower, upper = (limit[places] for limit in program.box)
    fixed = ~program.laplace.free
    if program.dirichlet is not None:
        own, values = np.flatnonzero(fixed), program.dirichlet.lower
        # a value beyond its bound makes the problem infeasible
        lower[own] = np.maximum(lower[own], values)
        upper[own] = np.minimum(upper[own], values)
    return lower, upper, np.tile(fixed, 2) & (lower >= upper)
