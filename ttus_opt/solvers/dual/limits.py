"""Bounds on voxels and order constraints along spokes, read from a program.

These are the limits that `structured` handles: bounds lower ≤ p ≤ upper of each voxel;
links, the order constraints p_v - p_w ≥ s between a voxel v and the next one outwards
w; and given values (hard Dirichlet voxels). The two fields of `field_pair` are spokes
of two voxels.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.problem.members import ProgramConstraint
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import Duals


@dataclass(frozen=True)
class Multipliers:
    """Multipliers of limits.

    Attributes:
        bounds: Of bounds and given values, positive at upper limits, shape (V,).
        links: Of order constraints, at their deeper voxel, non-negative, shape (V,).
    """

    bounds: Array
    links: Array


@dataclass(frozen=True)
class SpokeLimits:
    """Limits of one field; -inf and inf where there are none.

    Attributes:
        shape: Shape of the grid, (n_r, n_θ, n_z).
        lower: Lower bounds, shape (V,).
        upper: Upper bounds, shape (V,).
        given: Voxels whose value is given: lower = upper there, shape (V,).
        least: s of the link from a voxel to the next one outwards, shape (V,).
        links: By constraint name: the deeper voxel of every row, the row's factor on
            p_v - p_w, and s, shape (m,) each.
        given_by: Name of the constraint that prescribes values.
    """

    shape: tuple[int, int, int]
    lower: Array = field(repr=False)
    upper: Array = field(repr=False)
    given: NDArray[np.bool_] = field(repr=False)
    least: Array = field(repr=False)
    links: dict[str, tuple[IntArray, Array, Array]] = field(repr=False)
    given_by: str = ""

    @classmethod
    def of(cls, program: Program) -> SpokeLimits:
        """Read a program's constraints and bounds.

        Raises:
            ValueError: A row is not such a limit; the message names the constraint.
        """
        shape = program.laplace.grid.shape
        own = program.variables["p"]
        lower, upper = (limit[own] for limit in program.box)
        given = np.zeros(len(lower), dtype=bool)
        least = np.broadcast_to(-np.inf, len(lower))
        links, dirichlet = {}, program.dirichlet
        if program.constraints:  # copy only if they are changed below
            lower, upper, least = lower.copy(), upper.copy(), least.copy()
        for constraint in program.constraints:
            if constraint is dirichlet:
                given[~program.laplace.free] = True
                # a value beyond its bound makes the problem infeasible
                lower[given] = np.maximum(lower[given], constraint.lower)
                upper[given] = np.minimum(upper[given], constraint.upper)
                continue
            deeper, factor = _links(constraint, shape)
            bound, _ = row_limits(constraint, factor)
            least[deeper] = np.maximum(least[deeper], bound)
            links[constraint.name] = (deeper, factor, bound)
        name = "" if dirichlet is None else dirichlet.name
        return cls(shape, lower, upper, given, least, links, name)

    @property
    def stride(self) -> int:
        """Step in flat indices from a voxel to the next one outwards [–]."""
        return self.shape[1] * self.shape[2]

    @property
    def binding(self) -> bool:
        """Whether there is any limit other than given values."""
        open_ = ~self.given
        return bool(
            np.isfinite(self.lower[open_]).any()
            or np.isfinite(self.upper[open_]).any()
            or np.isfinite(self.least).any()
        )

    def by_layer(self, values: NDArray[Any]) -> NDArray[Any]:
        """Voxel values as one row per layer, shape (n_r, n_θ·n_z)."""
        return values.reshape(self.shape[0], -1)

    def contradiction(self) -> float:
        """Largest contradiction between limits; 0 if they are feasible.

        Bounds are propagated along links in both directions, which gives the feasible
        interval of every voxel.
        """
        low, up = self._carried()
        return float(np.max(low - up, initial=0.0))

    def proof_of_contradiction(self) -> Multipliers | None:
        """Multipliers that prove the largest contradiction; None if there is none.

        A bound of one voxel, propagated along links, contradicts that of another: the
        multipliers are 1 at both bounds and on every link between.
        """
        low, up = self._carried()
        gap = low - up
        layer, spoke = np.unravel_index(int(np.argmax(gap)), gap.shape)
        if gap[layer, spoke] <= 0.0:
            return None
        own_low = self.by_layer(self.lower)[:, spoke]
        own_up = self.by_layer(self.upper)[:, spoke]
        outer, inner = int(layer), int(layer)
        while own_low[outer] < low[outer, spoke]:
            outer += 1
        while own_up[inner] > up[inner, spoke]:
            inner -= 1
        if inner == outer:  # two limits of one voxel: their constraints are unknown
            return None
        bounds, links = np.zeros(gap.shape), np.zeros(gap.shape)
        bounds[inner, spoke], bounds[outer, spoke] = 1.0, -1.0
        links[inner:outer, spoke] = 1.0
        return Multipliers(bounds.reshape(-1), links.reshape(-1))

    def without_implied(self) -> SpokeLimits:
        """The same feasible set without bounds that are implied along links.

        A field that grows inwards and is at least 0 at the surface is so everywhere.
        With redundant bounds the multipliers would not be unique, and the active-set
        iteration would cycle.
        """
        low, up = self._carried()
        least, given = self.by_layer(self.least), self.by_layer(self.given)
        by_outer = np.zeros(low.shape, dtype=bool)
        by_inner = np.zeros(low.shape, dtype=bool)
        own_low, own_up = self.by_layer(self.lower), self.by_layer(self.upper)
        by_outer[:-1] = low[1:] + least[:-1] >= own_low[:-1]
        by_inner[1:] = up[:-1] - least[:-1] <= own_up[1:]
        return replace(
            self,
            lower=np.where((by_outer & ~given).reshape(-1), -np.inf, self.lower),
            upper=np.where((by_inner & ~given).reshape(-1), np.inf, self.upper),
        )

    def _carried(self) -> tuple[Array, Array]:
        """Lower and upper bounds propagated along links, by layer."""
        low, up = self.by_layer(self.lower).copy(), self.by_layer(self.upper).copy()
        least = self.by_layer(self.least)
        for i in range(len(low) - 2, -1, -1):
            np.maximum(low[i], low[i + 1] + least[i], out=low[i])
        for i in range(len(up) - 1):
            np.minimum(up[i + 1], up[i] - least[i], out=up[i + 1])
        return low, up

    def duals(self, multipliers: Multipliers) -> Duals:
        """Multipliers by name, with signs as in `ttus_opt.problem.verify.kkt`."""
        left, bounds = multipliers.links.copy(), multipliers.bounds
        rows = {}
        for name, (deeper, factor, bound) in self.links.items():
            # of several constraints on one link, the tightest gets the multiplier, and
            # of equal ones the first
            carried = np.where(bound >= self.least[deeper], left[deeper], 0.0)
            rows[name] = -carried / factor
            left[deeper] -= carried
        if self.given_by:
            rows[self.given_by] = bounds[self.given]
            bounds = np.where(self.given, 0.0, bounds)
        return Duals(rows, bounds)


def two_entries(matrix: sp.csr_array) -> tuple[IntArray, Array] | None:
    """Columns and values of rows, (m, 2) each; None unless all have two entries."""
    if (np.diff(matrix.indptr) != 2).any():
        return None
    columns = matrix.indices.reshape(-1, 2).astype(np.int64)
    values = matrix.data.reshape(-1, 2)
    if (columns[:, 0] > columns[:, 1]).any():
        order = np.argsort(columns, axis=1)
        values = np.take_along_axis(values, order, axis=1)
        columns = np.take_along_axis(columns, order, axis=1)
    return columns, values


def row_limits(constraint: ProgramConstraint, factor: Array) -> tuple[Array, Array]:
    """Least and largest value of what rows are multiples of, shape (m,) each."""
    lower, upper = constraint.lower / factor, constraint.upper / factor
    return np.minimum(lower, upper), np.maximum(lower, upper)


def _links(
    constraint: ProgramConstraint, shape: tuple[int, int, int]
) -> tuple[IntArray, Array]:
    """Deeper voxels and signs of rows ±(p_v - p_w) with one-sided limits."""
    stride = shape[1] * shape[2]
    refusal = f"{constraint.name} is neither a bound nor growth along spokes"
    pairs = two_entries(constraint.matrix)
    if pairs is None or pairs[0].max(initial=0) >= stride * shape[0]:
        raise ValueError(refusal)
    columns, values = pairs
    sign = values[:, 0]
    neighbours = columns[:, 1] - columns[:, 0] == stride
    if not (
        neighbours.all()
        and (values[:, 1] == -sign).all()
        and (np.abs(sign) == 1.0).all()
        and (row_limits(constraint, sign)[1] == np.inf).all()
        and np.bincount(columns[:, 0]).max(initial=0) <= 1
    ):
        raise ValueError(refusal)
    return columns[:, 0], sign


def refusal_of_limits(program: Program) -> str:
    """Why the limits are not bounds or growth along spokes; empty if they are."""
    free, prior = program.laplace.free, program.laplace_prior
    try:
        limits = SpokeLimits.of(program)
    except ValueError as error:
        return f"it takes bounds and growth along spokes: {error}"
    if not limits.binding:
        return ""
    if program.n_variables > len(free):
        return "it takes no limits of the field beside other unknowns"
    rows = None if prior is None else prior.laplace_rows
    scale = None if rows is None else rows.scale
    if prior is not None and scale is not None and (scale[free] != 1.0).any():
        return f"it takes {prior.name} only without limits of the field"
    return ""
